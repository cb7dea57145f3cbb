"""How a log is replayed, and who is told as it goes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.errors import UsageError
from mavkf.navigation.setup import MODELS
from mavkf.replay.faults import Fault
from mavkf.samples import IMU_SOURCES, Source
from mavkf.service.vehicle import Step, VehicleStream

Array = NDArray[np.float64]
OWN_FORM, OWN_ORDER = "joseph", "first"  # of the fold


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to replay.

    as_live: in the order of arrival, each pose as it would have been published; else in the order of measurement.
    rate_hz: rows a second of boot time, 0 for every step. span: boot times (s) to use.
    vehicle: `<sysid>-<compid>`, session: its number; None: all.
    imu: the IMU message to use; model: one of MODELS; None: chosen from the session's first seconds.
    faults: to put into the samples first. smooth: whether each pose rests on what came later too (not as_live).
    form, update: a form and an order of `mavkf.filters`, to run the flight with (not as_live, not smooth); None: as the service does.
    """

    as_live: bool = False
    rate_hz: float = 50.0
    span: tuple[float, float] = (-math.inf, math.inf)
    vehicle: str | None = None
    session: int | None = None
    imu: Source | None = None
    model: str | None = None
    config: Config = field(default_factory=Config)
    faults: tuple[Fault, ...] = ()
    smooth: bool = False
    form: str | None = None
    update: str | None = None

    @property
    def other_filter(self) -> tuple[str, str] | None:
        """The form and order to run with, where one of them was asked for."""
        if self.form is None and self.update is None:
            return None
        return self.form or OWN_FORM, self.update or OWN_ORDER


@dataclass(frozen=True, kw_only=True)
class Watch:
    """Who is told of a run as it goes.

    progress: what is being done ("estimating", "smoothing") and the share that is done.
    step: every step of a run as live, for what needs records.
    poses: vehicle, session, and pose rows (n, POSE_WIDTH; a view that is used again), those of a session in order.
    """

    progress: Callable[[str, float], object] = lambda what, share: None
    step: Callable[[VehicleStream, Step], object] | None = None
    poses: Callable[[str, int, Array], object] | None = None


NOBODY = Watch()


def imu_source(name: str | None) -> Source | None:
    """The IMU message of a name. Raises UsageError."""
    if name is None:
        return None
    for source in IMU_SOURCES:
        if source.name == name.upper():
            return source
    raise UsageError(
        f"--imu {name}: no IMU message of this name; choose one of {', '.join(source.name for source in IMU_SOURCES)}"
    )


def check(options: Options) -> Options:
    """The options, if they make sense. Raises UsageError."""
    if options.model is not None and options.model not in MODELS:
        raise UsageError(f"--model {options.model}: choose one of {', '.join(MODELS)}")
    if options.smooth and options.as_live:
        raise UsageError(
            "--smooth uses what came later, which no live run knows: leave --as-live, --jsonl and --publish out"
        )
    if options.other_filter is not None:
        from mavkf.filters.forms import FORMS  # what few runs need is imported for them
        from mavkf.filters.orders import ORDERS

        for option, name, known in (("form", options.form, FORMS), ("update", options.update, ORDERS)):
            if name is not None and name not in known:
                raise UsageError(f"--{option} {name}: choose one of {', '.join(known)}")
    if options.other_filter is not None and options.as_live:
        raise UsageError(
            "--form and --update go over a whole flight, which no live run has: leave --as-live, --jsonl and --publish out"
        )
    if options.other_filter is not None and options.smooth:
        raise UsageError("--smooth goes back over the filter's own form: leave --form and --update out")
    if not 0.0 <= options.rate_hz <= 10_000.0:
        raise UsageError(f"--rate {options.rate_hz:g}: give rows a second, or 0 for every step")
    if not options.span[0] < options.span[1]:
        raise UsageError(f"--from {options.span[0]:g} --to {options.span[1]:g}: the end must come after the beginning")
    return options
