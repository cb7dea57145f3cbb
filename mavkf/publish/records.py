"""The records of `mavkf.estimate` as bytes: JSON or MessagePack, the same record, and never a NaN.

Keys: `mavkf/<vehicle>/pose`, `.../pose/smoothed`, `.../status`, `.../event`, `.../innovation/<sensor>`; the liveliness
token is `.../alive`.
"""

import re
from collections.abc import Callable, Iterable
from math import isfinite
from typing import Any, Literal, TypeVar, get_args

import msgspec

from mavkf.errors import UsageError
from mavkf.estimate import Event, Innovation, Origin, Pose, Record, SmoothedPose, Status

Encoding = Literal["json", "msgpack"]
R = TypeVar("R", bound=Record)
What = Literal["pose", "pose/smoothed", "status", "event", "innovation"]

ENCODINGS: dict[str, str] = {"json": "application/json", "msgpack": "application/msgpack"}
"""The zenoh encoding of each payload format."""

TYPES: dict[str, type[Record]] = {
    "pose": Pose,
    "pose/smoothed": SmoothedPose,
    "status": Status,
    "event": Event,
    "innovation": Innovation,
}
"""The record type behind what follows the vehicle in a key (but for the sensor of an innovation)."""

_WHAT: dict[type, str] = {kind: what for what, kind in TYPES.items()}
_ELEMENTWISE = {"euler_deg", "pose_covariance", "r", "S"}  # null stands for one element, elsewhere for the vector
ENCODERS: dict[str, Callable[[Record], bytes]] = {
    "json": msgspec.json.Encoder().encode,
    "msgpack": msgspec.msgpack.Encoder().encode,
}
"""Turn a record that is `finite` into bytes."""

_JSON = {what: msgspec.json.Decoder(kind) for what, kind in TYPES.items()}
_MSGPACK = {what: msgspec.msgpack.Decoder(kind) for what, kind in TYPES.items()}
_NAME = re.compile(r"[A-Za-z0-9_-]+")


def check_name(name: str, *, role: str = "vehicle") -> str:
    """Give `name` back if it can be one part of a key, else raise UsageError."""
    if not _NAME.fullmatch(name):
        raise UsageError(f"{role} {name!r} cannot be part of a key: use letters, digits, '_' and '-', as in 1-1")
    return name


def check_choice(name: str, value: str, choices: Any) -> str:
    """Give `value` back if it is one of a Literal's choices, else raise UsageError."""
    if value not in get_args(choices):
        raise UsageError(f"{name} {value!r} is unknown: choose from {', '.join(get_args(choices))}")
    return value


def name_of(record: Record) -> str:
    """Give what follows the vehicle in the key that a record is published on."""
    return f"innovation/{record.sensor}" if isinstance(record, Innovation) else _WHAT[type(record)]


def key_of(record: Record) -> str:
    """Give the key that a record is published on."""
    return f"mavkf/{record.vehicle}/{name_of(record)}"


def encode(record: Record, encoding: Encoding = "json") -> bytes:
    """Turn a record into bytes; what is not finite becomes null first."""
    return ENCODERS[encoding](finite(record))


def decode(what: str, payload: bytes) -> Record:
    """Turn bytes of either encoding into a record; fields that this version does not know are passed over.

    The encoding is told by the first byte ('{' begins no MessagePack map), so a wrong label does no harm.

    Raises:
        msgspec.DecodeError: the payload is not such a record.

    """
    if payload[:1] == b"{":
        return _JSON[what].decode(payload)
    return _MSGPACK[what].decode(payload)


def schema() -> dict[str, Any]:
    """Give the JSON schema of the records; every field is always there."""
    _, components = msgspec.json.schema_components(TYPES.values(), ref_template="#/$defs/{name}")
    for component in components.values():
        if "properties" in component:
            component["required"] = list(component["properties"])
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "oneOf": [{"$ref": f"#/$defs/{kind.__name__}"} for kind in TYPES.values()],
        "$defs": components,
    }


def finite(record: R) -> R:
    """Give the record itself if all its numbers are finite, else a copy with null where they are not.

    A vector of which one element is not finite is null as a whole, unless its elements may be null one by one.
    """
    if _all_finite(msgspec.structs.astuple(record)):
        return record
    changed = {
        name: _cleaned(value, elementwise=name in _ELEMENTWISE)
        for name, value in msgspec.structs.asdict(record).items()
        if not _all_finite((value,))
    }
    return msgspec.structs.replace(record, **changed)


def _all_finite(values: Iterable[Any]) -> bool:
    total = 0.0  # an element that is not finite makes the sum so: in every published record, so one flat loop
    for value in values:
        kind = type(value)
        if kind is float:
            total += value
        elif kind is tuple or kind is list:
            try:
                total += sum(value)
            except TypeError:  # holds None, or names
                if not _all_finite(value):
                    return False
        elif (kind is dict and not _all_finite(value.values())) or (
            kind is Origin and not _all_finite(msgspec.structs.astuple(value))
        ):
            return False
    return isfinite(total)


def _cleaned(value: Any, *, elementwise: bool) -> Any:
    if isinstance(value, tuple | list) and elementwise:
        return tuple(element if _all_finite((element,)) else None for element in value)
    if isinstance(value, dict):
        return {name: element if _all_finite((element,)) else None for name, element in value.items()}
    return None
