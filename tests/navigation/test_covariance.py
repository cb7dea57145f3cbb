"""Prediction of the covariance by blocks against the dense product, and its shape over a whole run."""

from typing import Any

import numpy as np
import pytest
import sympy

from mavkf.models import constant_velocity, strapdown
from mavkf.models.strapdown import DBG, POS, SUMS, THETA, TOP, VEL, X_SIZE, N
from mavkf.navigation import layout as L
from mavkf.navigation.covariance import propagate_covariance
from mavkf.navigation.offline import Offline

Array = np.ndarray
COUPLED = np.zeros((9, TOP), dtype=bool)
"""Which states (columns) attitude, velocity and position (rows) follow in the models."""
COUPLED[:3, [THETA, THETA + 1, THETA + 2, VEL, VEL + 1, DBG, DBG + 1, DBG + 2]] = True
COUPLED[3:6] = True
COUPLED[3:6, POS : POS + 2] = False
COUPLED[6:9] = True
COUPLED[6:9, VEL : POS + 3] = np.hstack([np.eye(3), np.eye(3)])


def dense(Phi: Array) -> Array:
    F = np.eye(N)
    F[:9, :TOP] = Phi
    return F


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("model", [strapdown, constant_velocity])
def test_no_model_couples_what_is_not_read(model: Any, seed: int) -> None:
    random = np.random.default_rng(seed)
    x, sums, Phi = random.normal(size=X_SIZE), random.normal(size=SUMS), np.full((9, TOP), np.nan)
    model.transition(x, sums, 0.1, Phi)
    np.testing.assert_array_equal(Phi[~COUPLED], 0.0)


@pytest.mark.parametrize("seed", range(20))
def test_blocks_equal_the_dense_product(seed: int) -> None:
    random = np.random.default_rng(seed)
    A = random.normal(size=(N, N + 2))
    P = A @ A.T
    Phi = random.normal(size=(9, TOP)) * COUPLED
    expected = dense(Phi) @ P @ dense(Phi).T
    propagate_covariance(P, Phi)
    np.testing.assert_allclose(P, expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    np.testing.assert_array_equal(P, P.T)


def test_blocks_equal_the_dense_product_in_symbols() -> None:
    """The structure: F = [[A, B], [0, 1]] moves only the rows and columns of the first nine states."""
    A, B = sympy.MatrixSymbol("A", 9, 9), sympy.MatrixSymbol("B", 9, 7)
    P11, P12, P22 = sympy.MatrixSymbol("P", 9, 9), sympy.MatrixSymbol("Q", 9, 7), sympy.MatrixSymbol("R", 7, 7)
    F = sympy.BlockMatrix([[A, B], [sympy.ZeroMatrix(7, 9), sympy.Identity(7)]])
    P = sympy.BlockMatrix([[P11, P12], [P12.T, P22]])
    product = sympy.block_collapse(F * P * F.T)
    assert product.blocks[1, 1] == P22
    top, side = product.blocks[0, 0], product.blocks[0, 1]
    # the code: A P (rows of Phi times P) to the side, then (A P) Phi' on top
    rows = sympy.block_collapse(sympy.BlockMatrix([[A, B]]) * P)
    assert sympy.expand(side - rows.blocks[0, 1]) == sympy.ZeroMatrix(9, 7)
    assert sympy.expand(top - (rows.blocks[0, 0] * A.T + rows.blocks[0, 1] * B.T)) == sympy.ZeroMatrix(9, 9)


def test_stays_a_covariance_over_a_flight(batch: Offline) -> None:
    P = L.covariance(batch.state)
    np.testing.assert_array_equal(P, P.T)
    used = np.diag(P) > 0.0  # a model may leave states of another one alone
    assert used[:N].all()
    assert not P[~used].any()
    P = P[np.ix_(used, used)]
    scale = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > 1e-9
    for columns, size in ((L.R_POSE_COVARIANCE, 6), (L.R_VELOCITY_COVARIANCE, 3)):
        blocks = batch.output.poses[:, columns : columns + size * size].reshape(-1, size, size)
        blocks = blocks[np.all(np.isfinite(blocks), axis=(1, 2))]
        assert blocks.shape[0] > 1500
        np.testing.assert_array_equal(blocks, blocks.transpose(0, 2, 1))
        assert np.linalg.eigvalsh(blocks).min() > 0.0
