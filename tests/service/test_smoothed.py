"""The smoothed poses of a live vehicle, as records."""

import numpy as np

from mavkf.config import Config
from mavkf.estimate import Pose, SmoothedPose
from mavkf.link.decode import decode
from mavkf.link.framing import FrameStream
from mavkf.publish.records import decode as decode_record
from mavkf.publish.records import encode, key_of
from mavkf.service.vehicle import VehicleStream
from mavkf.service.warmup import BEGIN_US, flight

LAG = 3.0


def records(lag_s: float) -> list[object]:
    data, frames = FrameStream().push(b"".join(frame for _, frame in flight()), BEGIN_US, last=True)
    rows = decode(data, frames)[1, 1]
    stream = VehicleStream("1-1", Config(), lag_s=lag_s)
    steps = [step for piece in np.array_split(rows, 50) for step in stream.push(piece)]
    return [record for step in [*steps, *stream.finish()] for record in stream.records(step)]


def test_smoothed_poses_come_behind_on_a_key_of_their_own_each_once() -> None:
    found = records(LAG)
    smoothed = [record for record in found if isinstance(record, SmoothedPose)]
    times = [record.t_boot_s for record in smoothed]
    assert times == sorted(set(times))
    assert [record.seq for record in smoothed] == list(range(len(smoothed)))
    assert {key_of(record) for record in smoothed} == {"mavkf/1-1/pose/smoothed"}
    newest = -np.inf
    for record in found:
        if isinstance(record, SmoothedPose):
            # none is told while the set-up waits; at the end nothing more can come
            assert newest < 0.0 or newest > 12.5 or record.t_boot_s <= newest - LAG + 1.0
        elif isinstance(record, Pose):
            newest = record.t_boot_s
    live = {record.t_boot_s for record in found if type(record) is Pose}
    assert len(live & set(times)) > 100
    assert decode_record("pose/smoothed", encode(smoothed[-1])) == smoothed[-1]


def test_none_come_where_nobody_asked() -> None:
    assert not any(isinstance(record, SmoothedPose) for record in records(0.0))
