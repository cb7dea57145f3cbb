"""A Kalman filter of any model, in any form and order.

    from mavkf.filters import Filter
    from mavkf.filters.smoothers import modified_bryson_frazier
    from mavkf.models.textbook import falling_body as model

    kf = Filter(model, x0, P0, form="ud", order="second-order", record=True)
    for t, z in zip(times, measured):
        kf.predict(t - kf.t)        # x = f(x, u),  P = F P F' + Q
        y = kf.update(z)            # r = z - h(x),  S = H P H' + R,  x = x + K r
        print(kf.t, kf.x, kf.P, y.nis)
    x_smoothed, P_smoothed = modified_bryson_frazier(kf.history)

A model is a module (or any object) with these functions, x (n,), u whatever the model wants, dt in s:

    discrete      f(x, u, dt) -> (n,)      F(x, u, dt) = df/dx (n, n)     Q(x, dt) -> (n, n) covariance of the noise over dt
    continuous    f(x, u) = dx/dt          F(x, u) = df/dx (n, n)         Qc(x) -> (n, n) its spectral density
    measurement   h(x) -> (m,)             H(x) = dh/dx (m, n)            R (m, m)
    Hessians      F_xx (n, n, n)           H_xx (m, n, n)                 of each component, with the arguments of F and H: second order
    optional      residual(z, z_hat), where z - z_hat is not right (angles)

A model that has `Qc` is continuous: its moments are integrated by Runge-Kutta. Sensors other than the model's own are objects with h, H
and R, given to `update`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from mavkf.errors import UsageError
from mavkf.filters.continuous import transition
from mavkf.filters.forms import apply, form_named, noise_factor, nothing_known
from mavkf.filters.orders import ORDERS, iterate, second_order_covariance, second_order_mean
from mavkf.filters.smoothers import Step

Array = np.ndarray


@dataclass(frozen=True)
class Innovation:
    """What one measurement said.

    At t (s): r = z - z_hat (m,), NaN where missing, its covariance S (m, m), nis = r' S^-1 r (NaN of none) and the number of
    components that it is of, its degrees of freedom; the iterations of an iterated update (else 1).
    """

    t: float
    r: Array
    S: Array
    nis: float
    components: int
    iterations: int


def _array(value: Any, shape: tuple[int, ...], name: str) -> Array:
    array = np.array(value, dtype=float, order="C")
    if array.shape != shape:
        raise UsageError(f"{name} has the shape {array.shape}; it must be {shape}.")
    if np.isinf(array).any():
        raise UsageError(f"{name} is not finite: {array}.")
    return array


class Filter:
    """The estimate x (n,) of a model's state at time t (s), with its covariance P (n, n), predicted and corrected in place.

    history: every step so far, for the smoothers, if `record` was asked for.
    """

    def __init__(
        self,
        model: Any,
        x: Any,
        P: Any = None,
        *,
        form: str = "joseph",
        order: str = "first",
        t: float = 0.0,
        steps: int = 1,
        tolerance: float | None = None,
        record: bool = False,
    ) -> None:
        """Start at t with x (n,) and P (n, n); P None: nothing is known (information forms only), x is where to linearise.

        form: a name of `forms.FORMS`; order: first, iterated or second-order; steps, tolerance: Runge-Kutta of continuous models
        (`continuous.moments`). Raises UsageError for names, shapes, and a P that is no covariance.
        """
        if order not in ORDERS:
            raise UsageError(f"There is no order {order!r}; the orders are {', '.join(ORDERS)}.")
        self.model, self.form, self.order = model, form_named(form), order
        n = np.size(x)
        self.x = _array(x, (n,), "x")
        if np.isnan(self.x).any():
            raise UsageError(f"x is not finite: {self.x}.")
        self.t = t
        self.steps, self.tolerance = steps, tolerance
        if P is None:
            self._A = nothing_known(form, n)
        else:
            P = _array(P, (n, n), "P")
            noise_factor(P, "P")
            self._A = self.form.from_covariance(P)
            if not np.isfinite(self._A).all():
                raise UsageError(f"The form {form!r} needs a P that can be inverted.")
        self.history: list[Step] = []
        self._record = record
        if record:
            self._remember(np.eye(n), self.x, self.P)

    @property
    def P(self) -> Array:
        """The covariance (n, n); NaN where an information form cannot tell yet."""
        return np.asarray(self.form.to_covariance(self._A))

    def predict(self, dt: float, u: Any = None) -> None:
        """Go on by dt (s) under the input u. Raises UsageError for a negative dt, and where Q is no covariance."""
        if not dt >= 0.0:
            raise UsageError(f"dt is {dt:g} s; it must not be negative.")
        model = self.model
        if hasattr(model, "Qc"):
            Phi, Qd = self._integrate(dt, u)
        else:
            Phi, Qd = np.ascontiguousarray(model.F(self.x, u, dt), dtype=float), model.Q(self.x, dt)
            mean = model.f(self.x, u, dt)
            if self.order == "second-order":
                hessians, P = model.F_xx(self.x, u, dt), self._known()
                mean = mean + second_order_mean(hessians, P)
                Qd = Qd + second_order_covariance(hessians, P)
            self.x = np.asarray(mean, dtype=float)
        self.form.predict(self._A, Phi, *noise_factor(Qd))
        self.t += dt
        if self._record:
            self._remember(Phi, self.x, self.P)

    def update(self, z: Any, sensor: Any = None) -> Innovation:
        """Correct by z (m,), NaN where a component is missing, of the model's own sensor or another. Raises UsageError for shapes and R."""
        sensor = self.model if sensor is None else sensor
        x, P, R = self.x, self.P, np.ascontiguousarray(sensor.R, dtype=float)
        z = _array(z, R.shape[:1], "z")
        residual = getattr(sensor, "residual", np.subtract)

        def measure(at: Array) -> tuple[Array, Array]:
            H = np.ascontiguousarray(sensor.H(at), dtype=float)
            return residual(z, sensor.h(at)), _array(H, (len(z), len(x)), "H")

        r, H = measure(x)
        if self.order == "second-order":
            hessians = sensor.H_xx(x)
            r = r - second_order_mean(hessians, self._known())
            R = R + second_order_covariance(hessians, P)
        S = H @ P @ H.T + R
        there = ~np.isnan(r)
        used_H, used_r, iterations = H, r, 1
        if self.order == "iterated" and there.any():
            sigma = np.sqrt(np.diag(self._known()))
            self.x, used_r, used_H, iterations = iterate(self.form, self._A, x, sigma, measure, R)
        else:
            self.x = x + apply(self.form, self._A, H, R, r)
        if self._record:
            self._measured(used_H[there], R[np.ix_(there, there)], used_r[there])
        nis = float(r[there] @ np.linalg.solve(S[np.ix_(there, there)], r[there])) if there.any() else np.nan
        return Innovation(self.t, r, S, nis, int(there.sum()), iterations)

    def _integrate(self, dt: float, u: Any) -> tuple[Array, Array]:
        model, second = self.model, self.order == "second-order"
        P = self._known() if second or self.tolerance is not None else None
        self.x, Phi, Qd = transition(
            lambda x, _: model.f(x, u),
            lambda x, _: model.F(x, u),
            model.Qc(self.x),
            self.x,
            dt,
            P=P,
            F_xx=(lambda x, _: model.F_xx(x, u)) if second else None,
            steps=self.steps,
            tolerance=self.tolerance,
        )
        return Phi, Qd

    def _known(self) -> Array:
        P = self.P
        if np.isnan(P).any():
            raise UsageError(
                "The covariance is not known yet: what needs it (orders beyond the first, a tolerance) cannot start."
            )
        return P

    def _remember(self, Phi: Array, x: Array, P: Array) -> None:
        n = len(x)
        nothing = np.empty((0, n)), np.empty((0, 0)), np.empty(0)
        self.history.append(Step(self.t, Phi, x, P, *nothing, x, P))

    def _measured(self, H: Array, R: Array, r: Array) -> None:
        """The last step with its measurement; a second one at the same time is a step of its own that goes nowhere."""
        last = self.history[-1]
        Phi, x, P = last.Phi, last.x_predicted, last.P_predicted
        if len(last.r):
            Phi, x, P = np.eye(len(x)), last.x_filtered, last.P_filtered
        else:
            self.history.pop()
        self.history.append(Step(self.t, Phi, x, P, H, R, r, self.x, self.P))
