"""What faults there are, with their units and options in one table, and how one is written.

    KIND:at=SECONDS[,for=SECONDS][,size=NUMBER][,towards=DIRECTION][,OPTION=NUMBER]

as in `gyro-step:at=60,for=20,size=2,towards=-x`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mavkf.errors import UsageError
from mavkf.samples import GNSS_SOURCES, IMU_SOURCES, Kind, Source

Array = NDArray[np.float64]

BARO_SOURCES = (
    Source.SCALED_PRESSURE,
    Source.SCALED_PRESSURE2,
    Source.SCALED_PRESSURE3,
    Source.HIGHRES_IMU,
    Source.HIL_SENSOR,
)
SOURCES = {
    Kind.GNSS: GNSS_SOURCES,
    Kind.IMU: IMU_SOURCES,
    Kind.MAGNETOMETER: IMU_SOURCES,
    Kind.BAROMETER: BARO_SOURCES,
}
PLACE, BODY, ALL_AXES, NOWHERE = "n", "b", "all", ""  # what `towards` of a kind may be


@dataclass(frozen=True)
class FaultKind:
    """A kind of fault: whose rows it changes, what it does, the unit of its size ("": it has none), what `towards` may be, its options."""

    sensor: Kind
    meaning: str
    unit: str = ""
    towards: str = NOWHERE
    options: tuple[str, ...] = ()


KINDS = {
    "gnss-step": FaultKind(Kind.GNSS, "the position is off by a constant", "m", PLACE),
    "gnss-drift": FaultKind(Kind.GNSS, "the position runs away, the velocity stays true", "m/s", PLACE),
    "gnss-spoof": FaultKind(
        Kind.GNSS,
        "the velocity is off, by more and more up to `size`, and the position by the integral of that",
        "m/s",
        PLACE,
        ("acceleration",),
    ),
    "gnss-velocity": FaultKind(Kind.GNSS, "the velocity is off by a constant, the position stays true", "m/s", PLACE),
    "gnss-freeze": FaultKind(Kind.GNSS, "the last fix is repeated with stamps that go on"),
    "gnss-outage": FaultKind(Kind.GNSS, "there is no fix; silent=1: nor any message", options=("silent",)),
    "gnss-noise": FaultKind(
        Kind.GNSS,
        "white noise on the position, `size` one sigma of each axis, and claimed accuracies as before (jamming)",
        "m",
        options=("seed",),
    ),
    "magnetometer": FaultKind(Kind.MAGNETOMETER, "a field is added", "microtesla", BODY),
    "barometer": FaultKind(
        Kind.BAROMETER,
        "the pressure shows a height that is off; rise=S: builds up in S seconds",
        "m",
        options=("rise",),
    ),
    "gyro-step": FaultKind(Kind.IMU, "the angular rate is off by a constant", "deg/s", BODY),
    "accelerometer-step": FaultKind(Kind.IMU, "the specific force is off by a constant", "m/s^2", BODY),
    "gyro-scale": FaultKind(Kind.IMU, "the angular rate is multiplied by `size`", "(factor)", ALL_AXES),
    "accelerometer-scale": FaultKind(Kind.IMU, "the specific force is multiplied by `size`", "(factor)", ALL_AXES),
    "imu-gap": FaultKind(Kind.IMU, "no message of the IMU comes"),
}
"""All kinds of faults. Those of the IMU hit every IMU message and those of GNSS every receiver, unless `source` names one."""

OPTIONS = {
    "acceleration": "m/s^2: how fast the velocity of gnss-spoof builds up (0.2)",
    "rise": "s in which the height of barometer builds up (0)",
    "silent": "1: gnss-outage takes the messages away (0)",
    "seed": "of the noise of gnss-noise (1)",
}
NUMBERS = {"at": "at", "for": "lasts", "size": "size", **{name: name for name in OPTIONS}}  # as written: field of Fault


UPRIGHT = {"up": (0.0, 0.0, -1.0), "down": (0.0, 0.0, 1.0)}
AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
AXES |= {"-" + name: (-x, -y, -z) for name, (x, y, z) in AXES.items()}
DIRECTIONS = {
    PLACE: "towards=DEGREES from north, up or down",
    BODY: "towards=x, y, z (forward, right, down), -x, -y or -z",
    ALL_AXES: "towards=x, y or z, or without it: all axes",
    NOWHERE: "without a direction",
}


@dataclass(frozen=True, kw_only=True)
class Fault:
    """One fault. Raises UsageError, with the remedy, for what no such fault can be.

    kind:     one of KINDS. at: when it begins, s on the boot clock (in each session and vehicle); lasts: s, inf: to the end.
    size:     in the unit of the kind.
    towards:  degrees from north, "up" or "down" where the vector is in n; "x", "-x", "y" ... where it is in b. Scale errors: "x", "y",
              "z", or "" for all axes.
    source:   the message that has it; None: all of its sensor.
    acceleration (m/s^2), rise (s), silent, seed: as of OPTIONS.

    While t >= at and t < at + lasts it is there; afterwards the values are right again. t is the time of the sample's own stamp.
    """

    kind: str
    at: float
    lasts: float = math.inf
    size: float = 0.0
    towards: float | str = ""
    source: Source | None = None
    acceleration: float = 0.2
    rise: float = 0.0
    silent: float = 0.0
    seed: float = 1.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise UsageError(f"--fault {self.kind}: no such kind of fault; choose one of {', '.join(KINDS)}")
        kind, zero = KINDS[self.kind], kind_is_scale(self.kind)
        sources = SOURCES[kind.sensor]
        for good, what, right in (
            (math.isfinite(self.at), f"at={self.at:g}", "at=SECONDS of boot time at which it begins"),
            (self.lasts > 0.0, f"for={self.lasts:g}", "for=SECONDS, above 0 (or without)"),
            (math.isfinite(self.size), f"size={self.size:g}", "a number"),
            (not kind.unit or self.size != 0.0 or zero, "no size", f"size={kind.unit.upper()}, other than 0"),
            (kind.unit != "" or self.size == 0.0, f"size={self.size:g}", "no size: this kind has none"),
            (self._direction_is_good(kind), f"towards={self.towards}", DIRECTIONS[kind.towards]),
            (self.source is None or self.source in sources, "source", "source=" + "|".join(s.name for s in sources)),
            (0.0 < self.acceleration < math.inf, f"acceleration={self.acceleration:g}", "above 0 m/s^2"),
            (0.0 <= self.rise < math.inf, f"rise={self.rise:g}", "0 s or more"),
            (self.silent in (0.0, 1.0), f"silent={self.silent:g}", "0 or 1"),
            (self.seed >= 0.0 and self.seed % 1.0 == 0.0, f"seed={self.seed:g}", "a whole number, 0 or more"),
        ):
            if not good:
                raise UsageError(f"--fault {self.kind}: {what}, but must be {right}")

    def _direction_is_good(self, kind: FaultKind) -> bool:
        if kind.towards == PLACE:
            return self.towards in UPRIGHT or (not isinstance(self.towards, str) and math.isfinite(self.towards))
        if kind.towards == BODY:
            return str(self.towards) in AXES
        return self.towards == "" or (kind.towards == ALL_AXES and self.towards in ("x", "y", "z"))

    @property
    def end(self) -> float:
        """When it is over, s."""
        return self.at + self.lasts

    @property
    def direction(self) -> Array:
        """Unit vector (3) of `towards`, in n or b as its kind has it; of a scale error 1 for each axis that has it."""
        if KINDS[self.kind].towards == PLACE:
            if isinstance(self.towards, str):
                return np.array(UPRIGHT[self.towards])
            angle = math.radians(self.towards)
            return np.array([math.cos(angle), math.sin(angle), 0.0])
        return np.array(AXES[str(self.towards)]) if self.towards else np.ones(3)

    def __str__(self) -> str:
        """Give the text of which `parse_fault` makes this fault."""
        words = [f"at={self.at!r}"]
        if math.isfinite(self.lasts):
            words.append(f"for={self.lasts!r}")
        if KINDS[self.kind].unit:
            words.append(f"size={self.size!r}")
        if self.towards != "":
            words.append(f"towards={self.towards}")
        if self.source is not None:
            words.append(f"source={self.source.name}")
        words += [f"{name}={getattr(self, name)!r}" for name in KINDS[self.kind].options]
        return f"{self.kind}:{','.join(words)}"


def kind_is_scale(kind: str) -> bool:
    """Whether the size of a kind is a factor."""
    return KINDS[kind].towards == ALL_AXES


def parse_fault(text: str) -> Fault:
    """The fault that a text such as `gnss-step:at=103.7,for=8,size=40,towards=330` tells. Raises UsageError, with the remedy."""
    kind, _, rest = text.partition(":")
    if kind not in KINDS:
        raise UsageError(f"--fault {text}: no such kind of fault; choose one of {', '.join(KINDS)}")
    known = ["at", "for", *(["size"] if KINDS[kind].unit else []), *(["towards"] if KINDS[kind].towards else [])]
    known += ["source", *KINDS[kind].options]
    values: dict[str, Any] = {}
    for word in filter(None, rest.split(",")):
        name, equals, value = word.partition("=")
        if not equals or name not in known:
            raise UsageError(f"--fault {text}: {word!r} is not one of {', '.join(f'{each}=' for each in known)}")
        field = NUMBERS.get(name, name)
        if field in values:
            raise UsageError(f"--fault {text}: {name} is given twice; give it once, or two faults")
        values[field] = _value(text, name, value)
    if "at" not in values:
        raise UsageError(f"--fault {text}: when it begins is not told; add at=SECONDS of boot time")
    if kind_is_scale(kind) and "size" not in values:
        raise UsageError(f"--fault {text}: by what is not told; add size=FACTOR")
    try:
        return Fault(kind=kind, **values)
    except UsageError as error:
        raise UsageError(str(error).replace(f"--fault {kind}:", f"--fault {text}:", 1)) from None


def _value(text: str, name: str, value: str) -> float | str | Source:
    if name == "source":
        found = [source for source in Source if source.name == value.upper()]
        if not found:
            raise UsageError(f"--fault {text}: no message is called {value!r}; name one as RAW_IMU or GPS2_RAW")
        return found[0]
    try:
        return float(value)
    except ValueError:
        if name == "towards":
            return value
        raise UsageError(f"--fault {text}: {name}={value!r} is not a number") from None


def describe() -> Iterator[tuple[str, str, str]]:
    """Every kind of fault as (its name, how it is written, its meaning), in order, and then every option of theirs."""
    for name, kind in KINDS.items():
        words = ["at=S", "[for=S]"]
        words += [f"size={kind.unit}"] if kind.unit else []
        words += {PLACE: ["towards=DEG|up|down"], BODY: ["towards=[-]x|y|z"], ALL_AXES: ["[towards=x|y|z]"]}.get(
            kind.towards, []
        )
        yield name, ",".join([*words, *(f"[{option}=...]" for option in kind.options)]), kind.meaning
    for name, meaning in OPTIONS.items():
        yield name, "", meaning
