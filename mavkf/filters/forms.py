"""The forms by name, and what they have in common.

A form is a module with four compiled functions; A is its own array (P, a root of it, U and D packed, [Y | y], [R | z]):

    from_covariance(P) -> A        of P (n, n)
    to_covariance(A) -> P          NaN where an information form does not know yet
    predict(A, Phi, G, q)          P <- Phi P Phi' + G diag(q) G', in place; Phi (n, n), G (n, k), q (k,)
    update(A, H, r, dx)            in place, and fills dx = K r (n,); H (m, n) and r (m,) whitened (`whitening.whiten`)

The state is the caller's: the forms give the error state dx that it is to be moved by. So a filter that has alignment, gates and resets of
its own can change form without changing anything else.
"""

from types import ModuleType
from typing import Any

import numpy as np

from mavkf.errors import UsageError
from mavkf.filters import (
    carlson,
    covariance,
    extended_array,
    information,
    joseph,
    potter,
    square_root,
    square_root_information,
    ud,
)
from mavkf.filters.whitening import whiten

FORMS: dict[str, ModuleType] = {
    "covariance": covariance,
    "joseph": joseph,
    "potter": potter,
    "carlson": carlson,
    "square-root": square_root,
    "ud": ud,
    "information": information,
    "square-root-information": square_root_information,
    "extended-array": extended_array,
}
KEEP_INVERSE = ("information", "square-root-information")
"""The forms that carry the inverse of P: they need a regular P and Phi, and can start from knowing nothing."""


def form_named(name: str) -> ModuleType:
    """The module of a form; raises UsageError with the names there are."""
    if name not in FORMS:
        raise UsageError(f"There is no form {name!r}; the forms are {', '.join(FORMS)}.")
    return FORMS[name]


def nothing_known(name: str, n: int) -> np.ndarray:
    """The array (n, n + 1) of an information form that knows nothing of n states; raises UsageError for the other forms."""
    if name not in KEEP_INVERSE:
        raise UsageError(
            f"The form {name!r} needs a covariance to start from; only {' and '.join(KEEP_INVERSE)} do not."
        )
    return np.zeros((n, n + 1))


def noise_factor(Q: np.ndarray, name: str = "Q") -> tuple[np.ndarray, np.ndarray]:
    """G (n, n) and q (n,) with G diag(q) G' = Q, of a positive semi-definite Q (n, n): what `predict` takes.

    By the UD factors of Q. Raises UsageError, which calls it by `name`, where it is not a covariance.
    """
    Q = np.ascontiguousarray(Q, dtype=float)
    scale = np.sqrt(np.abs(np.diag(Q)))
    if not np.all(np.abs(Q - Q.T) <= 1e-9 * np.outer(scale, scale)) or np.any(np.diag(Q) < 0.0):
        raise UsageError(f"{name} must be symmetric with no negative variance.")
    A = ud.from_covariance(Q)
    q = np.diag(A).copy()
    G = np.triu(A, 1) + np.eye(len(Q))
    # what goes with a pivot that is nothing but rounding is of the size of the root of it
    tolerance = 4.0 * np.sqrt(len(Q) * np.finfo(float).eps)
    if np.any(q < 0.0) or not np.all(np.abs((G * q) @ G.T - Q) <= tolerance * np.outer(scale, scale)):
        raise UsageError(f"{name} must be positive semi-definite.")
    return G, q


def apply(form: Any, A: np.ndarray, H: np.ndarray, R: np.ndarray, r: np.ndarray) -> np.ndarray:
    """Correct A in place by one vector measurement of innovation r (m,), and return dx (n,).

    form: what has the `update` of a form.
    H: (m, n); R: (m, m) positive definite, correlated or not; NaN in r is a component that is missing. Raises UsageError where R is not
    positive definite.
    """
    H, R, r = (np.ascontiguousarray(array, dtype=float) for array in (H, R, r))  # or it would be compiled anew
    m, n = H.shape
    H_w, r_w, dx = np.empty((m, n)), np.empty(m), np.zeros(n)
    used = whiten(H, R, r, H_w, r_w)
    if used < 0:
        raise UsageError("R must be positive definite: give every measurement some noise.")
    if used:
        form.update(A, H_w[:used], r_w[:used], dx)
    return dx
