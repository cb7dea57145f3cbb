"""What the accuracy benchmarks do to recorded rows before they are estimated."""

import numpy as np

from benchmarks.accuracy.decimation import thin
from benchmarks.accuracy.outages import cut
from benchmarks.accuracy.sample_rows import heartbeats
from mavkf.samples import KIND, ROW_WIDTH, SEQUENCE, SOURCE, TIME, Kind, Source
from mavkf.service.senders import is_vehicle


def rows_of(kind: Kind, source: Source, times: np.ndarray) -> np.ndarray:
    rows = np.full((times.size, ROW_WIDTH), np.nan)
    rows[:, KIND], rows[:, SOURCE], rows[:, TIME] = kind, source, times
    rows[:, SEQUENCE] = np.arange(times.size) % 256
    return rows


def in_order(*parts: np.ndarray) -> np.ndarray:
    rows = np.concatenate(parts)
    return rows[np.argsort(rows[:, TIME], kind="stable")]


def test_thinning_keeps_whole_messages_at_the_rate_and_leaves_the_rest() -> None:
    t = 7.003 + np.arange(0, 10, 0.005)
    gnss = rows_of(Kind.GNSS, Source.GPS_RAW_INT, np.arange(7.1, 17.0, 0.2))
    slow = rows_of(Kind.IMU, Source.SCALED_IMU2, np.arange(7.05, 17.0, 0.5))
    rows = in_order(rows_of(Kind.MAGNETOMETER, Source.RAW_IMU, t), rows_of(Kind.IMU, Source.RAW_IMU, t), gnss, slow)
    thinned = thin(rows, 4.0)
    imu = thinned[(thinned[:, KIND] == Kind.IMU) & (thinned[:, SOURCE] == Source.RAW_IMU)]
    magnetometer = thinned[thinned[:, KIND] == Kind.MAGNETOMETER]
    assert imu.shape[0] == 40
    np.testing.assert_allclose(np.diff(imu[:, TIME]), 0.25, atol=0.0051)
    np.testing.assert_array_equal(imu[:, TIME], magnetometer[:, TIME])
    assert np.sum(thinned[:, KIND] == Kind.GNSS) == gnss.shape[0]
    assert np.sum(thinned[:, SOURCE] == Source.SCALED_IMU2) == slow.shape[0]


def test_thinning_is_causal() -> None:
    """What is kept of the first half does not depend on the second."""
    rows = rows_of(Kind.IMU, Source.RAW_IMU, 3.0 + np.cumsum(np.random.default_rng(1).uniform(0.001, 0.1, 1000)))
    whole = thin(rows, 10.0)
    half = thin(rows[:500], 10.0)
    np.testing.assert_array_equal(half, whole[: half.shape[0]])
    assert np.all(np.diff(np.round(whole[:, TIME], 9)) > 0.0)
    # after a message that came late the link does not make up for it with a burst
    assert whole.shape[0] <= 10.0 * (rows[-1, TIME] - rows[0, TIME]) + 1


def test_the_cut_takes_all_fixes_of_the_window_and_nothing_else() -> None:
    t = np.arange(0.0, 10.0, 0.2)
    rows = in_order(
        rows_of(Kind.GNSS, Source.GPS_RAW_INT, t),
        rows_of(Kind.GNSS, Source.GPS2_RAW, t + 0.1),
        rows_of(Kind.IMU, Source.RAW_IMU, t),
    )
    left = cut(rows, 4.0, 6.0)
    gnss = left[left[:, KIND] == Kind.GNSS]
    assert not np.any((gnss[:, TIME] >= 4.0) & (gnss[:, TIME] < 6.0))
    assert rows.shape[0] - left.shape[0] == 20
    assert np.sum(left[:, KIND] == Kind.IMU) == t.size


def test_a_drive_is_heard_as_a_vehicle() -> None:
    assert is_vehicle(heartbeats(0.0, 3.0, 1e15))
