"""What `mavkf watch` draws."""

import io

import msgspec
import pytest
from rich.console import Console

from mavkf.cli._screens import detail, fleet
from mavkf.cli._seen import Row
from mavkf.estimate import Consistency, Event, Innovation, Status

from .._pose import POSE


def drawn(what: object, width: int = 160) -> str:
    console = Console(width=width, file=io.StringIO(), force_terminal=False)
    console.print(what)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


STATUS = Status(
    vehicle="1-1",
    session=0,
    seq=4,
    model="strapdown",
    rates_hz={"imu": 50.0, "poses": 40.0},
    age_s={"imu": 0.25},
    innovations={"barometer": Consistency(count=256, refused=3, nis=0.5, sentence="barometer has outliers")},
)


def test_a_table_has_a_line_for_each_vehicle_and_says_who_is_silent() -> None:
    rows = [Row("2-1", 100.0), Row("1-1", 100.0), Row("3-1", 100.0)]
    rows[0].take(POSE, 109.5)
    rows[1].take(POSE, 104.0)
    rows[1].take(msgspec.structs.replace(STATUS, silent_s=6.0), 109.9)
    rows[2].take(STATUS, 109.0)
    lines = [line for line in drawn(fleet(rows, {"1-1"}, 110.0, 160)).splitlines() if "-1 " in line]
    assert [line.split()[0] for line in lines] == ["1-1", "2-1", "3-1"]
    assert "silent for 6 s" in lines[0] and "47.3977421" in lines[0]
    assert "0.5" in lines[1] and "still" in lines[1]
    assert "barometer?" in lines[2]
    gone = drawn(fleet(rows, {"1-1"}, 170.0, 160))
    assert "1-1" in gone and "2-1" not in gone


@pytest.mark.parametrize("width", [80, 110, 140, 200])
def test_a_table_fits_the_terminal(width: int) -> None:
    row = Row("1-1", 100.0)
    row.take(POSE, 100.0)
    text = drawn(fleet([row], {"1-1"}, 100.0, width), 400)
    assert max(map(len, text.splitlines())) <= width
    assert ("lat deg" in text) is (width >= 110)
    assert "roll pitch yaw" in text


def test_one_vehicle_in_detail() -> None:
    row = Row("1-1", 100.0)
    row.take(POSE, 100.0)
    row.take(STATUS, 100.0)
    row.take(
        Innovation(vehicle="1-1", session=0, seq=1, sensor="barometer", r=(7.5,), fused=False, reason="outlier"), 100.0
    )
    for k in range(20):
        row.take(Event(vehicle="1-1", session=0, seq=k, t_boot_s=float(k), kind="armed", text=f"event {k}"), 100.0)
    text = drawn(detail(row, "1-1", 100.5))
    for part in (
        "1-1, session 0",
        "navigating, strapdown",
        "0.5 s old",
        "47.3977421",
        "50.0",
        "barometer has outliers",
    ):
        assert part in text
    assert "7.50 outlier" in text
    assert "event 19" in text and "event 12" in text and "event 11" not in text
    assert "waiting for 9-1" in drawn(detail(None, "9-1", 0.0))
