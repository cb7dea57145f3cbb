"""Poses of a few seconds ago, by what came since: against the truth, the live filter, and themselves."""

import numpy as np
import pytest

from mavkf.config import Config
from mavkf.navigation import fixed_lag
from mavkf.navigation import layout as L
from mavkf.navigation.estimator import SessionEstimator
from mavkf.samples import TIME

from ._session import CONFIG, position_error, session

Array = np.ndarray
LAG = 4.0


def flown(rows: Array, pieces: int, config: Config = CONFIG) -> tuple[Array, Array]:
    """Pose rows as live, and smoothed with the lag, of rows that come in so many pieces a second."""
    estimator = SessionEstimator(config, lag_s=LAG)
    live, smoothed = [], []
    order = np.argsort(rows[:, TIME], kind="stable")
    last = rows[order[-1], TIME]
    edges = np.arange(99 * pieces, (int(last) + 1) * pieces) / pieces
    place = np.searchsorted(rows[order, TIME], edges)
    for first, end, now in zip(place, [*place[1:], len(order)], [*edges[1:], int(last) + 1.0], strict=True):
        live += [output.poses for output in estimator.push(rows[order[first:end]])]
        if now % 1.0 < 1e-9:
            smoothed.append(estimator.smoothed(now))
    smoothed.append(estimator.smoothed(last + LAG))
    return np.concatenate(live), np.concatenate(smoothed)


def common(live: Array, smoothed: Array) -> tuple[Array, Array]:
    """The rows of both that are of the same time and have a position."""
    _, i, k = np.intersect1d(live[:, L.R_TIME], smoothed[:, L.R_TIME], return_indices=True)
    known = np.isfinite(live[i, L.R_LATITUDE]) & np.isfinite(smoothed[k, L.R_LATITUDE])
    return live[i[known]], smoothed[k[known]]


def test_every_pose_comes_once_in_order_and_is_nearer_to_the_truth() -> None:
    live, smoothed = flown(session(60.0), 1)
    times = smoothed[:, L.R_TIME] - 100.0
    assert np.all(np.diff(times) > 0.0)
    assert np.all(np.diff(times[times > 20.0]) < 0.03)
    live, smoothed = common(live, smoothed)
    late = live[:, L.R_TIME] > 130.0
    assert late.sum() > 1000
    before, after = (np.sqrt(np.mean(position_error(each[late]) ** 2)) for each in (live, smoothed))
    assert after < 0.9 * before
    variance = [L.R_POSE_COVARIANCE + 7 * i for i in range(6)]
    assert np.all(smoothed[late][:, variance] <= live[late][:, variance] * (1.0 + 1e-6))


def test_how_the_rows_are_cut_into_pieces_makes_no_difference() -> None:
    rows = session(30.0)
    np.testing.assert_array_equal(flown(rows, 1)[1], flown(rows, 5)[1])


def test_what_is_older_than_the_window_is_left_out_and_counted() -> None:
    rows = session(30.0)
    estimator = SessionEstimator(CONFIG, lag_s=LAG)
    for _ in estimator.push(rows):
        pass
    estimator.smoothed(129.0)
    assert estimator._lagging is not None
    for _ in estimator.push(rows[rows[:, TIME] < 120.0][-50:]):
        pass
    assert estimator._lagging.left_out == 50


def test_a_clock_that_stands_still_does_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fixed_lag, "MOST", 500)
    rows = session(30.0)
    estimator = SessionEstimator(CONFIG, lag_s=LAG)
    for _ in estimator.push(rows):
        pass
    lagging = estimator._lagging
    assert lagging is not None
    assert sum(map(len, lagging._events)) == 500
    assert lagging.left_out > 1000
