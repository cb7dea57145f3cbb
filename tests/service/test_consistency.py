"""What the status says of recent innovations: bounded, forgetful, and the same however the rows are cut."""

import numpy as np
from numpy.typing import NDArray

from mavkf.estimate import Consistency
from mavkf.navigation import layout as L
from mavkf.navigation.codes import Sensor
from mavkf.samples import Source
from mavkf.service.consistency import JUDGED_EVERY, NEWEST, WAITING, WINDOW, RecentInnovations

MAIN = float(Source.GPS_RAW_INT)
SENSORS = ((Sensor.GNSS_POSITION, Source.GPS_RAW_INT, 3), (Sensor.BAROMETER, Source.SCALED_PRESSURE, 1))


def innovations(start: float, count: int, scale: float = 1.0, step: float = 0.1) -> NDArray[np.float64]:
    """Rows of both sensors, `scale` times as large as claimed; from a seed."""
    random = np.random.default_rng(int(start * 10))
    rows = np.zeros((2 * count, L.INNOVATION_WIDTH))
    for k, (sensor, source, size) in enumerate(SENSORS):
        mine = rows[k::2]
        mine[:, L.I_TIME] = start + step * np.arange(count)
        mine[:, L.I_SENSOR], mine[:, L.I_SOURCE], mine[:, L.I_SIZE] = sensor, source, size
        mine[:, L.I_R : L.I_R + size] = scale * random.normal(size=(count, size))
        mine[:, L.I_S : L.I_S + size * size] = np.eye(size).ravel()
        mine[:, L.I_NIS] = np.sum(mine[:, L.I_R : L.I_R + size] ** 2, axis=1)
        mine[:, L.I_LIMIT], mine[:, L.I_FUSED] = 25.0, 1.0
    return rows


def reports(scale: float, seconds: int = 30, cut: int = 20) -> list[dict[str, Consistency]]:
    recent, found = RecentInnovations(), []
    for t in range(seconds):
        rows = innovations(float(t), 10, scale)
        for i in range(0, len(rows), cut):
            recent.take(rows[i : i + cut])
        found.append(recent.report(t + 1.0, 5.0, MAIN, 100.0))
    return found


def test_a_right_filter_has_its_nis_and_no_sentence() -> None:
    last = reports(1.0)[-1]
    assert set(last) == {"gnss_position", "barometer"}
    for each in last.values():
        assert each.sentence is None
        assert (each.refused, each.nis is not None and 0.7 < each.nis < 1.3) == (0, True)


def test_a_wrong_one_is_named() -> None:
    last = reports(2.0)[-1]
    assert last["gnss_position"].nis is not None
    assert last["gnss_position"].nis > 3.0
    for name, each in last.items():
        assert each.sentence is not None
        assert each.sentence.startswith(name)


def test_cutting_the_rows_otherwise_changes_nothing() -> None:
    assert reports(1.7, cut=3) == reports(1.7, cut=20)


def test_what_is_older_than_the_window_is_forgotten() -> None:
    recent = RecentInnovations()
    recent.take(innovations(0.0, 50, 3.0))
    for t in range(6, 6 + 2 * JUDGED_EVERY):  # each of the two has had its turn
        before = recent.report(float(t), 5.0, MAIN, 100.0)
    assert all(each.sentence for each in before.values())
    recent.take(innovations(60.0, 30))
    after = recent.report(WINDOW + 4.95, 5.0, MAIN, 100.0)
    assert {each.count for each in after.values()} == {30}
    assert recent.report(2.0 * WINDOW + 70.0, 5.0, MAIN, 100.0) == {}


def test_refused_ones_without_a_nis_are_counted() -> None:
    rows = innovations(0.0, 30)
    rows[1::4, L.I_FUSED], rows[1::4, L.I_NIS] = 0.0, np.nan
    rows[0::2, L.I_FUSED] = 0.0
    recent = RecentInnovations()
    recent.take(rows)
    found = recent.report(3.0, 5.0, MAIN, 100.0)
    assert (found["gnss_position"].count, found["gnss_position"].refused, found["gnss_position"].nis) == (0, 30, None)
    assert (found["barometer"].count, found["barometer"].refused) == (15, 15)
    assert found["barometer"].nis is not None
    assert 0.3 < found["barometer"].nis < 2.5


def test_a_flood_is_bounded() -> None:
    """Without a report, and with one: no more than the newest are kept."""
    recent = RecentInnovations()
    for k in range(30):
        recent.take(innovations(float(k), 500, step=1e-3))
        assert sum(map(len, recent._waiting)) <= 2 * WAITING + 1000
    found = recent.report(30.0, 5.0, MAIN, 100.0)
    assert {each.count for each in found.values()} == {NEWEST}
    assert {(len(rows), int(last - first)) for rows, (first, last) in recent._kept.values()} == {(2 * NEWEST, NEWEST)}
