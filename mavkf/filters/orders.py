"""What lies beyond the first order: corrections from Hessians, and iteration.

For a Gaussian error of covariance P the second-order terms of a function g, with Hessians g_i'' of its components, have

    mean        m_i  = 1/2 tr(g_i'' P)
    covariance  L_ij = 1/2 tr(g_i'' P g_j'' P)

Athans, Wishner and Bertolini, "Suboptimal State Estimation for Continuous-Time Nonlinear Systems from Discrete Noisy Measurements", IEEE
Trans. Automatic Control AC-13 (1968); Bar-Shalom, Li and Kirubarajan, "Estimation with Applications to Tracking and Navigation" (2001),
section 10.3.2. The second-order filter adds them in prediction and update; both are exact where g is quadratic. A covariance L in the
measurement acts as more of R, in the prediction as more of Q, so every form can use them.

The iterated update solves for the most probable state by Gauss-Newton (Bell and Cathey, "The Iterated Kalman Filter Update as a
Gauss-Newton Method", IEEE Trans. Automatic Control 38, 1993): each iteration starts from the prior again, with h and H at the newest
estimate.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from mavkf.filters.forms import apply

Array = np.ndarray
ORDERS = ("first", "iterated", "second-order")


def second_order_mean(hessians: Array, P: Array) -> Array:
    """m (k,): the mean of the second-order terms. hessians: (k, n, n), of each component; P: (n, n)."""
    return np.asarray(0.5 * np.einsum("aij,ij->a", hessians, P))


def second_order_covariance(hessians: Array, P: Array) -> Array:
    """L (k, k): the covariance of the second-order terms. hessians: (k, n, n), of each component; P: (n, n)."""
    products = hessians @ P
    return np.asarray(0.5 * np.einsum("aij,bji->ab", products, products))


def iterate(
    form: Any,
    A: Array,
    x: Array,
    sigma: Array,
    measure: Callable[[Array], tuple[Array, Array]],
    R: Array,
    limit: int = 20,
    tolerance: float = 1e-8,
) -> tuple[Array, Array, Array, int]:
    """The iterated update: returns x (n,), the r (m,) and H (m, n) of the last iteration, and the number of iterations.

    form: what has the `update` of a form.
    A: its array, corrected in place; x: (n,) predicted; sigma: (n,) its standard deviations, in which a step is measured;
    measure(x): innovation z - h(x) (m,), NaN where missing, and H (m, n). Ends when no state moves by more than `tolerance` of its
    sigma, or after `limit` iterations (the count is then `limit`): the last linearisation stands.
    """
    prior = A.copy()
    estimate, count, moving = x, 0, True
    while moving and count < limit:
        innovation, H = measure(estimate)
        r = innovation - H @ (x - estimate)
        A[...] = prior
        newest = x + apply(form, A, H, R, r)
        moving = not np.all(np.abs(newest - estimate) <= tolerance * sigma)
        estimate = newest
        count += 1
    return estimate, r, H, count
