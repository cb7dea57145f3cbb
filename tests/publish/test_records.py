import json
from math import inf, nan
from typing import Any

import msgspec
import pytest

from mavkf.errors import UsageError
from mavkf.estimate import Consistency, Event, Innovation, Mode, Pose, Record, Status
from mavkf.publish.records import Encoding, check_name, decode, encode, finite, key_of, schema

from .conftest import make_pose

RECORDS: list[tuple[str, Record]] = [
    ("pose", make_pose(3)),
    ("pose", Pose(vehicle="1-1", session=0, seq=0)),
    ("status", Status(vehicle="x", session=1, seq=2, mode=Mode.ALIGNING, rates_hz={"imu": 4.0}, counts={"lost": 3})),
    ("innovation", Innovation(vehicle="x", session=1, seq=2, sensor="gnss", r=(0.5,), S=(2.0,), nis=0.125, fused=True)),
    ("event", Event(vehicle="x", session=1, seq=2, kind="reset", size=4.5, evidence={"nis": 91.0, "by": "gnss"})),
    (
        "status",
        Status(
            vehicle="x",
            session=1,
            seq=2,
            innovations={
                "barometer": Consistency(count=0, refused=3),
                "gnss_position": Consistency(count=9, refused=0, nis=0.5, sentence="gnss_position is refused"),
            },
        ),
    ),
]


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize(("what", "record"), RECORDS)
def test_a_record_comes_back_as_it_was(what: str, record: Record, encoding: Encoding) -> None:
    assert decode(what, encode(record, encoding)) == record


@pytest.mark.parametrize(("what", "record"), RECORDS)
def test_both_encodings_hold_the_same_and_begin_with_the_head(what: str, record: Record) -> None:
    as_json = json.loads(encode(record, "json"))
    assert as_json == msgspec.msgpack.decode(encode(record, "msgpack"))
    head = ["schema_version", "vehicle", "session", "seq", "t_boot_s", "utc_ns"]
    assert list(as_json)[:6] == head
    assert list(schema()["$defs"][type(record).__name__]["properties"])[:6] == head


@pytest.mark.parametrize(("what", "record"), RECORDS)
def test_a_record_fits_the_schema(what: str, record: Record) -> None:
    written = schema()
    check(json.loads(encode(record)), written["$defs"][type(record).__name__], written["$defs"])


def check(value: object, rule: dict[str, Any], defs: dict[str, Any]) -> None:
    """As much of JSON schema as the printed one uses; anything else in it fails."""
    unknown = set(rule) - {
        *("title", "description", "default", "type", "properties", "required", "items", "prefixItems", "enum"),
        *("minItems", "maxItems", "additionalProperties", "anyOf", "$ref"),
    }
    assert not unknown
    if "$ref" in rule:
        return check(value, defs[rule["$ref"].rsplit("/", 1)[1]], defs)
    if "anyOf" in rule:
        kinds = {"null": type(None), "number": float, "integer": int, "string": str, "array": list, "boolean": bool}
        fitting = [
            choice
            for choice in rule["anyOf"]
            if isinstance(value, dict if "$ref" in choice else kinds[choice["type"]])
            or (choice.get("type") == "number" and isinstance(value, int))
        ]
        assert fitting, (value, rule)
        return check(value, fitting[0], defs)
    if "enum" in rule:
        assert value in rule["enum"]
    elif rule["type"] == "object":
        assert isinstance(value, dict) and set(rule.get("required", ())) <= set(value)
        for name, element in value.items():
            check(element, rule.get("properties", {}).get(name) or rule["additionalProperties"], defs)
    elif rule["type"] == "array":
        assert isinstance(value, list)
        assert rule.get("minItems", 0) <= len(value) <= rule.get("maxItems", len(value))
        for index, element in enumerate(value):
            check(element, rule["prefixItems"][index] if "prefixItems" in rule else rule["items"], defs)
    else:
        kind = {"null": type(None), "number": int | float, "integer": int, "string": str, "boolean": bool}[rule["type"]]
        assert isinstance(value, kind)
    return None


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
@pytest.mark.parametrize("bad", [nan, inf, -inf])
def test_what_is_not_finite_becomes_null(bad: float, encoding: Encoding) -> None:
    covariance = (bad, *(0.0,) * 35)
    pose = make_pose(
        lat_deg=bad, velocity_ned_m_s=(1.0, bad, 2.0), euler_deg=(1.0, 2.0, bad), pose_covariance=covariance
    )
    seen = decode("pose", encode(pose, encoding))
    assert isinstance(seen, Pose)
    assert seen.lat_deg is None
    assert seen.velocity_ned_m_s is None
    assert seen.euler_deg == (1.0, 2.0, None)
    assert seen.pose_covariance == (None, *(0.0,) * 35)
    assert seen.lon_deg == pose.lon_deg


@pytest.mark.parametrize("encoding", ["json", "msgpack"])
def test_nan_in_other_records_becomes_null(encoding: Encoding) -> None:
    innovation = Innovation(
        vehicle="x", session=0, seq=0, sensor="gnss", r=(nan, 1.0), S=(nan,) * 4, nis=nan, fused=False
    )
    seen = decode("innovation", encode(innovation, encoding))
    assert isinstance(seen, Innovation)
    assert (seen.r, seen.S, seen.nis) == ((None, 1.0), (None,) * 4, None)
    event = Event(vehicle="x", session=0, seq=0, kind="reset", size=nan, evidence={"a": nan, "b": 1.0})
    seen_event = decode("event", encode(event, encoding))
    assert isinstance(seen_event, Event)
    assert (seen_event.size, seen_event.evidence) == (None, {"a": None, "b": 1.0})


def test_a_finite_record_is_not_copied() -> None:
    pose = make_pose()
    assert finite(pose) is pose


def test_fields_of_a_later_version_are_passed_over() -> None:
    later = json.loads(encode(make_pose(7))) | {"schema_version": 2, "wind_ned_m_s": [1.0, 2.0, 3.0]}
    seen = decode("pose", json.dumps(later).encode())
    assert (seen.schema_version, seen.seq) == (2, 7)
    assert decode("pose", msgspec.msgpack.encode(later)) == seen


@pytest.mark.parametrize(
    "payload", [b"", b"{", b"{}", b"null", b"\xff\xfe", b'{"seq": "x"}', b"{\x80", b"\xc1", b"[1]"]
)
def test_garbage_is_one_kind_of_error(payload: bytes) -> None:
    with pytest.raises(msgspec.MsgspecError):
        decode("pose", payload)


def test_keys() -> None:
    assert key_of(RECORDS[0][1]) == "mavkf/1-1/pose"
    assert key_of(RECORDS[3][1]) == "mavkf/x/innovation/gnss"
    assert check_name("my_drone-2") == "my_drone-2"
    for bad in ("", "a/b", "*", "ä", "a b", "a\n"):
        with pytest.raises(UsageError, match="letters, digits"):
            check_name(bad)
