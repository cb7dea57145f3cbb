"""The vehicles that are heard: a stream and a publisher for each, made when it first gives something.

One that falls silent is stale (its status says so), later gone (its publisher is withdrawn), and at last forgotten: should it return
then, it begins a new session with nothing known.
"""

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import msgspec
import numpy as np
import zenoh
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.errors import MavkfError
from mavkf.estimate import Event, Record, Status
from mavkf.link.decode import Address, DecodeCounts, decode
from mavkf.link.layouts import message_ids
from mavkf.publish.publisher import Congestion, Publisher
from mavkf.publish.records import Encoding
from mavkf.samples import Source
from mavkf.service.senders import is_vehicle
from mavkf.service.vehicle import Step, VehicleStream

MOST = 250
"""Senders that are followed; the memory of each is bounded, so that of all is."""
STALE_S, GONE_S, FORGET_S = 3.0, 30.0, 600.0
HEARTBEAT = message_ids()["HEARTBEAT"]


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to estimate and publish.

    rate_hz:     poses a second of boot time, 0 for one each IMU sample.
    imu, model:  forced choices, None: from a session's first seconds.
    names:       of vehicles in keys, by `<sysid>-<compid>`; others are called by that.
    congestion:  what a slow reader costs: its records ("drop") or time ("block").
    quiet:       say only what went wrong.
    lag_s:       publish smoothed poses too, so many seconds behind; 0: none.
    control:     whether others may act on the service over zenoh.
    metrics:     host and port of metrics for Prometheus, None: none.
    """

    rate_hz: float = 50.0
    imu: Source | None = None
    model: str | None = None
    config: Config = field(default_factory=Config)
    names: dict[str, str] = field(default_factory=dict)
    encoding: Encoding = "json"
    congestion: Congestion = "drop"
    quiet: bool = False
    lag_s: float = 0.0
    control: bool = False
    metrics: tuple[str, int] | None = None


class Vehicle:
    """One vehicle: its stream, and its publisher once there is one."""

    def __init__(self, name: str, stream: VehicleStream, now: float) -> None:
        self.name, self.stream = name, stream
        self.publisher: Publisher | None = None
        self.told_session = -1
        self.poses = 0
        self.rows = 0
        self.heard_s = now  # of the service's steady clock, as all of this
        self.stale_told_s = -np.inf
        self.status: Status | None = None

    @property
    def has_estimate(self) -> bool:
        """Whether its estimator is at work."""
        return self.stream.estimator is not None and self.stream.estimator.setup is not None


class Fleet:
    """Frames in, records published. Not for several threads at once."""

    def __init__(
        self,
        session: zenoh.Session,
        options: Options,
        say: Callable[[str], None],
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        """session: stays open; say: takes what the user should know; now: a steady clock, s."""
        self.vehicles: dict[Address, Vehicle] = {}
        self.refused = DecodeCounts()
        self.errors: list[MavkfError] = []
        self.given_up: set[Address] = set()
        """Vehicles that nothing is estimated of any more."""
        self.is_late = False
        """Set from outside: the work is behind what arrives, so innovations and older poses are not published."""
        self.unpublished: Counter[str] = Counter()
        """Records that were not published because of that: "pose", "innovation"."""
        self.when_ended: Callable[[], None] = lambda: None
        """Called when a session was ended by the service itself: what comes now should be recorded apart."""
        self.when_published: Callable[[Address, Record], None] = lambda _, __: None
        """Called with every record that was published."""
        self.poses = 0
        """Poses published so far."""
        self._ignored: set[Address] = set()
        self._others: set[Address] = set()  # by their heartbeats
        self._autopilots: set[Address] = set()
        self._next_session: dict[Address, int] = {}
        self._configs: dict[Address, Config] = {}  # other than that of the options
        self._is_full = False
        self._session, self._options, self.warn, self._now = session, options, say, now
        self._say = (lambda _: None) if options.quiet else say

    def declare(self, addresses: Iterable[Address]) -> list[Publisher]:
        """Make the publishers of vehicles before they give anything, so that subscribers can be waited for."""
        addresses = list(addresses)
        self._autopilots.update(addresses)
        return [self._publisher(self._vehicle(address)) for address in addresses]

    def ignore(self, addresses: Iterable[Address]) -> None:
        """Never follow these senders."""
        self._ignored.update(addresses)

    def take(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> None:
        """Take frames in the order of arrival, and publish what comes of them."""
        beating = set(frames[["system", "component"]][frames["message"] == HEARTBEAT].tolist())
        for address, rows in decode(data, frames, self.refused).items():
            if address in beating and not (address in self._autopilots or address in self._ignored):
                self._listen(address, rows)
            if address in self._ignored or address in self._others:
                continue
            if address in self.vehicles or self._has_room():
                self._hear(self._vehicle(address), len(rows))
                self._run(address, partial(_push, rows=rows))

    def look_after(self) -> None:
        """See to the vehicles that have fallen silent; call it several times a second."""
        now = self._now()
        for address, vehicle in list(self.vehicles.items()):
            silent = self.silent_s(vehicle)
            if silent >= FORGET_S:
                self._end(address, "forgotten", f"silent for {silent:.0f} s: should it return, it begins anew")
                self._drop(address)
            elif vehicle.publisher is not None and silent >= GONE_S:
                self._say(f"vehicle {vehicle.name} is gone: nothing has come for {silent:.0f} s")
                vehicle.publisher.close()
                vehicle.publisher = None
            elif vehicle.publisher is not None and silent >= STALE_S and now - vehicle.stale_told_s >= 1.0:
                self._tell_stale(vehicle, silent)

    def reset(self, vehicle: Vehicle, config: Config) -> None:
        """End the session of a vehicle and begin another with nothing known; config: of that and those after it."""
        address = next(address for address, one in self.vehicles.items() if one is vehicle)
        self._configs[address] = config
        self._end(address, "reset", "the estimate was reset on request: everything begins anew")
        vehicle.stream = self._stream(address)

    def silent_s(self, vehicle: Vehicle) -> float:
        """How long nothing has come of a vehicle, s."""
        return self._now() - vehicle.heard_s

    def finish(self) -> None:
        """Take it that nothing more will come, and publish what waited."""
        for address in list(self.vehicles):
            self._run(address, VehicleStream.finish)

    def close(self) -> None:
        """Withdraw the publishers."""
        for vehicle in self.vehicles.values():
            if vehicle.publisher is not None:
                vehicle.publisher.close()
                vehicle.publisher = None

    def _listen(self, address: Address, rows: NDArray[np.float64]) -> None:
        """Tell by the heartbeats among its rows whether a sender is a vehicle; one that is known to be stays one."""
        said = is_vehicle(rows)
        if said:
            self._autopilots.add(address)
            self._others.discard(address)
        elif said is False:
            self._others.add(address)
            self._drop(address)

    def _hear(self, vehicle: Vehicle, rows: int) -> None:
        now = self._now()
        if now - vehicle.heard_s >= STALE_S and vehicle.rows:
            self._say(f"vehicle {vehicle.name} is heard again after {now - vehicle.heard_s:.0f} s")
        vehicle.heard_s = now
        vehicle.rows += rows

    def _tell_stale(self, vehicle: Vehicle, silent: float) -> None:
        if vehicle.stale_told_s < vehicle.heard_s:
            self._say(f"vehicle {vehicle.name} is silent")
        vehicle.stale_told_s = self._now()
        if vehicle.status is not None:
            self._publisher(vehicle).publish(msgspec.structs.replace(vehicle.status, silent_s=silent))

    def _vehicle(self, address: Address) -> Vehicle:
        vehicle = self.vehicles.get(address)
        if vehicle is None:
            stream = self._stream(address)
            vehicle = self.vehicles[address] = Vehicle(stream.writer.vehicle, stream, self._now())
        return vehicle

    def _stream(self, address: Address) -> VehicleStream:
        options, name = self._options, f"{address[0]}-{address[1]}"
        first = self._next_session.get(address, 0)
        name = options.names.get(name, name)
        config = self._configs.get(address, options.config)
        return VehicleStream(
            name, config, options.rate_hz, options.imu, options.model, first_session=first, lag_s=options.lag_s
        )

    def _publisher(self, vehicle: Vehicle) -> Publisher:
        if vehicle.publisher is None:
            options = self._options
            vehicle.publisher = Publisher(self._session, vehicle.name, options.encoding, options.congestion)
            self._say(f"vehicle {vehicle.name}: publishes mavkf/{vehicle.name}/pose")
        return vehicle.publisher

    def _has_room(self) -> bool:
        """Make room for another sender: the one of which least has come goes, unless all are at work."""
        if len(self.vehicles) < MOST:
            return True
        if not self._is_full:
            self.warn(f"more than {MOST} senders: those that send least are not followed")
            self._is_full = True
        now = self._now()
        idle = [
            (vehicle.rows, vehicle.heard_s, address)
            for address, vehicle in self.vehicles.items()
            if not vehicle.has_estimate or now - vehicle.heard_s >= GONE_S
        ]
        if not idle:
            return False
        self._drop(min(idle)[2])
        return True

    def _run(self, address: Address, work: Callable[[VehicleStream], Iterator[Step]]) -> None:
        vehicle = self._vehicle(address)
        try:
            for step in work(vehicle.stream):
                self._publish(address, vehicle, step)
        except MavkfError as error:  # a forced choice that this vehicle cannot serve; the others go on
            self.errors.append(error)
            self.given_up.add(address)
            self.warn(f"vehicle {vehicle.name} is given up: {error}")
            self._ignored.add(address)
            self._drop(address)

    def _publish(self, address: Address, vehicle: Vehicle, step: Step) -> None:
        publisher = self._publisher(vehicle)
        self._tell_setup(vehicle, step)
        poses = step.output.poses.shape[0]
        if self.is_late:
            self.unpublished["innovation"] += step.output.innovations.shape[0]
            self.unpublished["pose"] += max(poses - 1, 0)
            poses = min(poses, 1)
        self.poses += poses
        vehicle.poses += poses
        for record in vehicle.stream.records(step, is_late=self.is_late):
            publisher.publish(record)
            self.when_published(address, record)
            if isinstance(record, Event):
                self._say(f"vehicle {vehicle.name}: {record.text}")
            elif isinstance(record, Status):
                vehicle.status = record

    def _tell_setup(self, vehicle: Vehicle, step: Step) -> None:
        estimator = vehicle.stream.estimator
        if step.session == vehicle.told_session or estimator is None or estimator.setup is None:
            return
        vehicle.told_session = step.session
        for reason in estimator.setup.reasons:
            self._say(f"vehicle {vehicle.name}: {reason}")

    def _end(self, address: Address, kind: str, text: str) -> None:
        """End the session of a vehicle: publish what waited, and why no more comes of it."""
        vehicle = self.vehicles[address]
        if not vehicle.stream.is_vehicle:
            return  # nothing can have come of it
        self._run(address, VehicleStream.finish)
        if address in self.vehicles:
            self._next_session[address] = vehicle.stream.session + 1
            event = vehicle.stream.event(kind, text)
            self._publisher(vehicle).publish(event)
            self.when_published(address, event)
            self._say(f"vehicle {vehicle.name}: {text}")
        self.when_ended()

    def _drop(self, address: Address) -> None:
        vehicle = self.vehicles.pop(address, None)
        if vehicle is not None and vehicle.publisher is not None:
            vehicle.publisher.close()


def _push(stream: VehicleStream, rows: NDArray[np.float64]) -> Iterator[Step]:
    return stream.push(rows)
