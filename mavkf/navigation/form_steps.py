"""One form of the filter at the fold's error state: its steps, their cost, and the states that are considered, not corrected."""

import time

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.filters.dense import cholesky
from mavkf.filters.forms import KEEP_INVERSE, form_named
from mavkf.models.strapdown import DFIELD, DIRON

Array = NDArray[np.float64]
ROUNDING = 1e-9  # of a covariance of noise, against the product of two standard deviations
FLOOR, FLOOR_FIELD = 1e-8, 1e-20  # variance, SI and T^2: of a state that is known exactly, for a form that inverts P


class Cost(msgspec.Struct):
    """How often a form was stepped, and the seconds that its compiled steps took."""

    predictions: int = 0
    prediction_s: float = 0.0
    updates: int = 0
    update_s: float = 0.0


class FormSteps:
    """The steps of a form as the contract of `mavkf.filters.forms` has them, timed, for a state that may have considered parts.

    considered (n,): the states that the next updates leave alone (Schmidt). The forms know no such update, but have all that it takes:
    with the optimal gain K and another one K - D, P is what the optimal update leaves, plus D S D'. So it is the form's own update, and
    then its own prediction with D, which is K in the considered rows and zero in the others, as noise.

    A form that keeps the inverse of P has no place for a state that is known exactly: its variance is taken as FLOOR, a ten thousandth of
    a unit squared.

    The standard form is kept symmetric, the least of its usual remedies: what rounding leaves of P - P' is not corrected by (1 - K H) P but
    grows with every measurement, and over minutes of flight it ends the filter.
    """

    def __init__(self, form: str) -> None:
        """form: a name of `mavkf.filters.forms.FORMS`; raises UsageError with the names there are."""
        self.module = form_named(form)
        self.inverse = form in KEEP_INVERSE
        self._loses_symmetry = form == "covariance"
        self.cost = Cost()
        self.considered: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def floor(self, n: int) -> Array:
        """The least variance (n,) of each state: zero where the form can represent that."""
        least = np.full(n, FLOOR if self.inverse else 0.0)
        least[DFIELD : DIRON + 3] = FLOOR_FIELD if self.inverse else 0.0
        return least

    def from_covariance(self, P: Array) -> Array:
        """The form's array of P (n, n)."""
        exact = np.where(np.diag(P) <= 0.0, self.floor(len(P)), 0.0)
        return np.asarray(self.module.from_covariance(np.ascontiguousarray(P + np.diag(exact))))

    def to_covariance(self, A: Array) -> Array:
        """P (n, n) of the form's array."""
        return np.asarray(self.module.to_covariance(A))

    def predict(self, A: Array, Phi: Array, G: Array, q: Array) -> None:
        """P <- Phi P Phi' + G diag(q) G', in place."""
        begin = time.perf_counter()
        self.module.predict(A, Phi, G, q)
        self._repair(A)
        self.cost.prediction_s += time.perf_counter() - begin
        self.cost.predictions += 1

    def update(self, A: Array, H: Array, r: Array, dx: Array) -> None:
        """Correct A in place by whitened measurements H (m, n), r (m,), and fill dx (n,), zero where a state is considered."""
        begin = time.perf_counter()
        if np.any(self.considered):
            PHt = self.to_covariance(A) @ H.T
            root = np.linalg.cholesky(H @ PHt + np.eye(len(r)))
            # D S D' = (D L) (D L)' with S = L L' and D = P H' S^-1 in the considered rows: D L = P H' L^-T
            G = np.where(self.considered[:, None], np.linalg.solve(root, PHt.T).T, 0.0)
            self.module.update(A, H, r, dx)
            self.module.predict(A, np.eye(len(dx)), np.ascontiguousarray(G), np.ones(len(r)))
            dx[self.considered] = 0.0
        else:
            self.module.update(A, H, r, dx)
        self._repair(A)
        self.cost.update_s += time.perf_counter() - begin

    def _repair(self, A: Array) -> None:
        if self._loses_symmetry:
            A[...] = 0.5 * (A + A.T)


def noise_columns(Q: Array) -> tuple[Array, Array] | None:
    """G (n, k) and q (k,) with G diag(q) G' = Q (n, n): unit columns where it is diagonal; None where Q is no covariance."""
    variances = np.diag(Q)
    used = np.flatnonzero(variances > 0.0)
    if np.count_nonzero(Q) == used.size:
        return np.eye(len(Q))[:, used], variances[used]
    G, sigma = cholesky(Q)[:, used], np.sqrt(np.maximum(variances, 0.0))
    if np.any(np.abs(G @ G.T - Q) > ROUNDING * np.outer(sigma, sigma)):
        return None
    return G, np.ones(used.size)
