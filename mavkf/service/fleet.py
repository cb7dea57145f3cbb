"""The vehicles that are heard: a stream and a publisher for each, made when it first gives something."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import zenoh
from numpy.typing import NDArray

from mavkf.config import Config
from mavkf.errors import MavkfError
from mavkf.estimate import Event
from mavkf.link.decode import Address, DecodeCounts, decode
from mavkf.publish.publisher import Congestion, Publisher
from mavkf.publish.records import Encoding
from mavkf.samples import KIND, VEHICLE_TYPE, Kind, Source
from mavkf.service.vehicle import Step, VehicleStream

GROUND_STATION = 6  # MAV_TYPE_GCS
MOST = 250
"""Senders that are followed; the memory of each is bounded, so that of all is."""


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to estimate and publish.

    rate_hz:     poses a second of boot time, 0 for one each IMU sample.
    imu, model:  forced choices, None: from a session's first seconds.
    names:       of vehicles in keys, by `<sysid>-<compid>`; others are called by that.
    congestion:  what a slow reader costs: its records ("drop") or time ("block").
    quiet:       say only what went wrong.
    """

    rate_hz: float = 50.0
    imu: Source | None = None
    model: str | None = None
    config: Config = field(default_factory=Config)
    names: dict[str, str] = field(default_factory=dict)
    encoding: Encoding = "json"
    congestion: Congestion = "drop"
    quiet: bool = False


class Vehicle:
    """One vehicle: its stream, and its publisher once there is one."""

    def __init__(self, name: str, options: Options) -> None:
        self.name = name
        self.stream = VehicleStream(name, options.config, options.rate_hz, options.imu, options.model)
        self.publisher: Publisher | None = None
        self.told_session = -1
        self.poses = 0


class Fleet:
    """Frames in, records published. Not for several threads at once."""

    def __init__(self, session: zenoh.Session, options: Options, say: Callable[[str], None]) -> None:
        """session: stays open; say: takes what the user should know."""
        self.vehicles: dict[Address, Vehicle] = {}
        self.refused = DecodeCounts()
        self.errors: list[MavkfError] = []
        self.given_up: set[Address] = set()
        """Vehicles that nothing is estimated of any more."""
        self._ignored: set[Address] = set()
        self._is_full = False
        self._session, self._options, self.warn = session, options, say
        self._say = (lambda _: None) if options.quiet else say

    @property
    def poses(self) -> int:
        """Poses published so far."""
        return sum(vehicle.poses for vehicle in self.vehicles.values())

    def declare(self, addresses: Iterable[Address]) -> list[Publisher]:
        """Make the publishers of vehicles before they give anything, so that subscribers can be waited for."""
        return [self._publisher(self._vehicle(address)) for address in addresses]

    def ignore(self, addresses: Iterable[Address]) -> None:
        """Never follow these senders."""
        self._ignored.update(addresses)

    def take(self, data: NDArray[np.uint8], frames: NDArray[np.void]) -> None:
        """Take frames in the order of arrival, and publish what comes of them."""
        for address, rows in decode(data, frames, self.refused).items():
            if address in self._ignored:
                continue
            if np.any(rows[rows[:, KIND] == Kind.HEARTBEAT, VEHICLE_TYPE] == GROUND_STATION):
                self._drop(address)
            elif address in self.vehicles or self._has_room():
                self._run(address, partial(_push, rows=rows))

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

    def _vehicle(self, address: Address) -> Vehicle:
        vehicle = self.vehicles.get(address)
        if vehicle is None:
            name = f"{address[0]}-{address[1]}"
            vehicle = self.vehicles[address] = Vehicle(self._options.names.get(name, name), self._options)
        return vehicle

    def _publisher(self, vehicle: Vehicle) -> Publisher:
        if vehicle.publisher is None:
            options = self._options
            vehicle.publisher = Publisher(self._session, vehicle.name, options.encoding, options.congestion)
            self._say(f"vehicle {vehicle.name}: publishes mavkf/{vehicle.name}/pose")
        return vehicle.publisher

    def _has_room(self) -> bool:
        if len(self.vehicles) < MOST:
            return True
        if not self._is_full:
            self.warn(f"more than {MOST} senders: further ones are not followed")
            self._is_full = True
        return False

    def _run(self, address: Address, work: Callable[[VehicleStream], Iterator[Step]]) -> None:
        vehicle = self._vehicle(address)
        try:
            for step in work(vehicle.stream):
                self._publish(vehicle, step)
        except MavkfError as error:  # a forced choice that this vehicle cannot serve; the others go on
            self.errors.append(error)
            self.given_up.add(address)
            self.warn(f"vehicle {vehicle.name} is given up: {error}")
            self._drop(address)

    def _publish(self, vehicle: Vehicle, step: Step) -> None:
        publisher = self._publisher(vehicle)
        self._tell_setup(vehicle, step)
        vehicle.poses += step.output.poses.shape[0]
        for record in vehicle.stream.records(step):
            publisher.publish(record)
            if isinstance(record, Event):
                self._say(f"vehicle {vehicle.name}: {record.text}")

    def _tell_setup(self, vehicle: Vehicle, step: Step) -> None:
        estimator = vehicle.stream.estimator
        if step.session == vehicle.told_session or estimator is None or estimator.setup is None:
            return
        vehicle.told_session = step.session
        for reason in estimator.setup.reasons:
            self._say(f"vehicle {vehicle.name}: {reason}")

    def _drop(self, address: Address) -> None:
        self._ignored.add(address)
        vehicle = self.vehicles.pop(address, None)
        if vehicle is not None and vehicle.publisher is not None:
            vehicle.publisher.close()


def _push(stream: VehicleStream, rows: NDArray[np.float64]) -> Iterator[Step]:
    return stream.push(rows)
