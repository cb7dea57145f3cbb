"""A linear model from its matrices: x = F x + B u + w, z = H x + v."""

import numpy as np

from mavkf.errors import UsageError

Array = np.ndarray


class Linear:
    """Constant matrices as a model for `Filter`; its functions are those that `estimator` asks of a model. R: (m, m)."""

    def __init__(self, F: Array, H: Array, Q: Array, R: Array, B: Array | None = None) -> None:
        """F and Q (n, n), H (m, n), R (m, m), and B (n, k) of the control input, if there is one.

        Q and R are the covariances of w and v, Q in one step; dt only moves the clock. Raises UsageError where the shapes do not fit.
        """
        self._F, self._H, self._Q, self.R = (np.array(matrix, dtype=float, ndmin=2) for matrix in (F, H, Q, R))
        self._B = None if B is None else np.array(B, dtype=float, ndmin=2)
        n, m = len(self._F), len(self._H)
        wanted = {"F": (self._F, (n, n)), "H": (self._H, (m, n)), "Q": (self._Q, (n, n)), "R": (self.R, (m, m))}
        for name, (matrix, shape) in wanted.items():
            if matrix.shape != shape:
                raise UsageError(f"{name} has the shape {matrix.shape}; beside the others it must have {shape}.")
        if self._B is not None and len(self._B) != n:
            raise UsageError(f"B has the shape {self._B.shape}; it must have {n} rows.")

    def f(self, x: Array, u: Array | None, dt: float) -> Array:
        """F x + B u. Raises UsageError where there is a u and no B."""
        after = self._F @ x
        if u is None:
            return np.asarray(after)
        if self._B is None:
            raise UsageError("A control input u needs its matrix B.")
        return np.asarray(after + self._B @ u)

    def F(self, x: Array, u: Array | None, dt: float) -> Array:
        """df/dx."""
        return self._F

    def F_xx(self, x: Array, u: Array | None, dt: float) -> Array:
        """Hessians of f: none."""
        return np.zeros((len(x),) * 3)

    def Q(self, x: Array, dt: float) -> Array:
        """Covariance of w in one step."""
        return self._Q

    def h(self, x: Array) -> Array:
        """H x."""
        return np.asarray(self._H @ x)

    def H(self, x: Array) -> Array:
        """dh/dx."""
        return self._H

    def H_xx(self, x: Array) -> Array:
        """Hessians of h: none."""
        return np.zeros((len(self._H), len(x), len(x)))
