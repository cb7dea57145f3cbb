"""Estimation theory on matrices: it knows no model and no drone.

    mavkf.filters.Filter                    a filter of any model, in any form and order, in a few lines
    mavkf.filters.Linear                    a linear model from its matrices
    mavkf.filters.forms                     the forms by name, and their contract

One file a subject: the forms (`covariance`, `joseph`, `potter`, `carlson`, `square_root`, `ud`, `information`, `square_root_information`,
`extended_array`), `kalman` (the linear filter's equations in one place), `orders` (second order, iterated), `continuous`
(moments by Runge-Kutta), `discretise` (Van Loan), `kalman_bucy`, `steady_state`, `smoothers`.
"""

from typing import TYPE_CHECKING, Any

__all__ = ["Filter", "Linear"]

if TYPE_CHECKING:
    from mavkf.filters.estimator import Filter
    from mavkf.filters.linear import Linear


def __getattr__(name: str) -> Any:
    """The public names, imported when first used: the estimator of flights needs one form only."""
    if name == "Filter":
        from mavkf.filters.estimator import Filter

        return Filter
    if name == "Linear":
        from mavkf.filters.linear import Linear

        return Linear
    raise AttributeError(f"module 'mavkf.filters' has no attribute {name!r}")
