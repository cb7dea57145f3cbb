"""Another filter on the fold's flight: any form, any order, with the fold's alignment, gates, resets, Phi, G, q, H, R and z.

The fold runs with a tape in detail, and this filter does what stands on it. Its estimate is the fold's, moved by an error state d (n,);
its covariance is the form's own array A:

    transition       A.predict(Phi, G, q),                          d <- Phi d
    correction       A.update(H, R, r - H d) gives dx,              d <- d + dx - K r, what the fold has moved by itself
    state set anew   what a reset, a first heading or another model has made of the fold: A from its covariance, d <- 0
    link             a state that has become a multiple of another and noise, by the same change of both

Where the noise is no covariance the transition is made on the form's covariance: the fourth order in which the telemetry model integrates
its noise does not reach what a driven force does to the position in one short step, and correlations come out beyond one.
A turn of d is composed with that of the correction, not added. Of first order d is rounding; the other orders make it what they are worth.
Iterated: Gauss-Newton from the prior each time. Second order: Hessians at its own estimate. Both have h and H anew where the fold fuses a
sensor's message; levelling, rest, what is known of the vehicle's class and the samples of a slow IMU are linear at the fold's estimate.

The prediction is of first order for all: what the second order would add is too little to be seen. With it, 5.01, 5.00 and 5.02 % of the
predicted states would lie outside the region of 95 % on the recorded flights ap01, ap05 and ap03 (`mavkf.diagnostics.linearisation` over
the time between two fixes, `mavkf replay --diagnose`); with a slow IMU its noise is most of the prediction.
"""

import msgspec
import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError
from mavkf.filters.forms import apply
from mavkf.filters.orders import ORDERS, iterate, second_order_covariance, second_order_mean
from mavkf.models.strapdown import BG, DGNSS, retract
from mavkf.models.telemetry import OMEGA
from mavkf.navigation import layout as L
from mavkf.navigation import tape as T
from mavkf.navigation.form_steps import FormSteps, noise_columns
from mavkf.navigation.pose import show
from mavkf.navigation.relinearise import Measurement, composed
from mavkf.navigation.tape_reader import Correction, Entry, correction, entries, noise, snapshot, transition

Array = NDArray[np.float64]


class FormRun(msgspec.Struct):
    """What another filter was: its form and order, steps and the microseconds of one, and how often it began anew from the fold."""

    form: str
    order: str
    predictions: int
    prediction_us: float
    updates: int
    update_us: float
    restarts: int


class AnyForm:
    """A filter in another form and order that follows a tape in detail."""

    def __init__(self, form: str, order: str, P: Array, c: Array) -> None:
        """P: (n, n) of the fold before the first event; c: parameters. Raises UsageError for a form or an order that there is not."""
        if order not in ORDERS:
            raise UsageError(f"There is no order {order!r}; the orders are {', '.join(ORDERS)}.")
        self.form, self.order, self._c = form, order, c
        self.steps = FormSteps(form)
        self._restarts = -1
        self._measurement: Measurement | None = None
        self._Phi: Array | None = None
        self._restart(P)

    @property
    def run(self) -> FormRun:
        """What it has been so far."""
        cost = self.steps.cost
        return FormRun(
            self.form,
            self.order,
            cost.predictions,
            1e6 * cost.prediction_s / max(cost.predictions, 1),
            cost.updates,
            1e6 * cost.update_s / max(cost.updates, 1),
            self._restarts,
        )

    def follow(self, tape: Array, poses: Array) -> None:
        """Do what stands on a tape, and put this filter's estimates into the pose rows (n, POSE_WIDTH) that it tells of."""
        for entry in entries(tape):
            if entry.kind == T.BREAK:
                self._restart(entry.content.reshape(entry.n, entry.n))
                continue
            if entry.n != len(self.d):
                self._resize(entry.n)
            if entry.kind == T.TRANSITION:
                if self._Phi is not None:
                    self._predict()
                self._Phi = transition(entry)
                if self.steps.inverse:
                    phi = np.diag(self._Phi)[DGNSS : DGNSS + 3]
                    self._after[range(DGNSS, DGNSS + 3), range(DGNSS, DGNSS + 3)] += (
                        1.0 - phi * phi
                    ) * self.steps.floor(entry.n)[DGNSS : DGNSS + 3]
            elif entry.kind == T.NOISE:
                (self._before if self._Phi is None else self._after)[...] += noise(entry)
            elif entry.kind == T.SNAPSHOT:
                self._measurement = Measurement(*snapshot(entry), self._c) if self.order != "first" else None
            elif entry.kind == T.CORRECTION:
                self._predict()
                self._correct(correction(entry))
            elif entry.kind == T.LINK:
                self._predict()
                self._link(*entry.content)
            elif entry.kind == T.POSE:
                self._predict()
                self._show(entry, poses[int(entry.content[T.P_ROW])])

    @property
    def covariance(self) -> Array:
        """Its covariance (n, n), without what is still to be predicted."""
        return self.steps.to_covariance(self._A)

    def _restart(self, P: Array) -> None:
        self._take(P)
        self.d = np.zeros(len(P))
        self._restarts += 1
        self._measurement = None

    def _take(self, P: Array) -> None:
        self._A = self.steps.from_covariance(P)
        self._Phi = None
        self._before, self._after = np.zeros(P.shape), np.zeros(P.shape)

    def _resize(self, n: int) -> None:
        """Have n states: what is new is not known to be anything but zero until a link says so; what goes leaves the marginal."""
        self._predict()
        both = min(n, len(self.d))
        P, d = np.zeros((n, n)), np.zeros(n)
        P[:both, :both], d[:both] = self.covariance[:both, :both], self.d[:both]
        self._take(P)
        self.d = d
        self._measurement = None

    def _link(self, to: float, of: float, factor: float, variance: float) -> None:
        n = len(self.d)
        E = np.eye(n)
        E[int(to)] = 0.0
        E[int(to), int(of)] = factor
        P = E @ self.covariance @ E.T
        P[int(to), int(to)] += variance
        self._take(P)
        self.d = E @ self.d

    def _predict(self) -> None:
        """Do what is pending: Phi with the noise before and after it."""
        n = len(self.d)
        Phi = self._Phi if self._Phi is not None else np.eye(n)
        if self._Phi is None and not np.any(self._before) and not np.any(self._after):
            return
        before, after = noise_columns(self._before), noise_columns(self._after)
        if before is None or after is None:
            self._A = self.steps.from_covariance(Phi @ (self.covariance + self._before) @ Phi.T + self._after)
        else:
            G = np.ascontiguousarray(np.hstack([Phi @ before[0], after[0]]))
            self.steps.predict(self._A, Phi, G, np.concatenate([before[1], after[1]]))
        self.d = Phi @ self.d
        self._Phi = None
        self._before[:], self._after[:] = 0.0, 0.0

    def _correct(self, done: Correction) -> None:
        """One correction, which has moved the fold by K r."""
        self.steps.considered = done.considered
        self.steps.cost.updates += 1
        moved = done.K @ done.r
        here, m = self._measurement, len(done.r)
        number = here.next(done.sensor, m) if here is not None else 0
        if here is not None and here.at(self.d, done.sensor, m, number) is None:
            here = None
        if here is None or self.order == "first":
            d = self.d + apply(self.steps, self._A, done.H, done.R, done.r - done.H @ self.d)
        elif self.order == "iterated":
            d = self._iterated(here, done, number)
        else:
            d = self._second(here, done, number)
        self.d = composed(-moved, d) if here is not None else d - moved
        if self._measurement is not None:
            self._measurement.moved = composed(self._measurement.moved, moved)

    def _iterated(self, here: Measurement, done: Correction, number: int) -> Array:
        """delta (n,) after it, in the error states about the fold's estimate before it."""

        def measure(delta: Array) -> tuple[Array, Array]:
            found = here.at(delta, done.sensor, len(done.r), number)
            return (found.r, found.H) if found is not None else (done.r - done.H @ delta, done.H)

        sigma = np.sqrt(np.diag(self.covariance))
        return np.asarray(iterate(self.steps, self._A, self.d, sigma, measure, done.R)[0])

    def _second(self, here: Measurement, done: Correction, number: int) -> Array:
        P, m = self.covariance, len(done.r)
        found = here.at(self.d, done.sensor, m, number)
        assert found is not None
        hessians = here.hessians(self.d, np.sqrt(np.diag(P)), done.sensor, m, number)
        # of r = z - h: its Hessians are those of h, for H is that of h
        r = found.r - second_order_mean(hessians, P)
        R = done.R + second_order_covariance(hessians, P)
        return np.asarray(self.d + apply(self.steps, self._A, found.H, R, r))

    def _show(self, entry: Entry, row: Array) -> None:
        """Put estimate and covariance into a pose row of the fold, whose validity, mode, flags and protection levels stay."""
        n, before = entry.n, entry.content[T.P_X : T.P_P]
        x = before.copy()
        retract(x, self.d)
        if entry.content[T.P_MODEL] == L.TELEMETRY:
            row[L.R_RATE : L.R_RATE + 3] += x[OMEGA : OMEGA + 3] - before[OMEGA : OMEGA + 3]
        else:
            row[L.R_RATE : L.R_RATE + 3] -= x[BG : BG + 3] - before[BG : BG + 3]
        show(x, self.covariance[:n, :n], int(row[L.R_VALID]), row)
