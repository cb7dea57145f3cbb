"""How the service is doing, for Prometheus, over HTTP; nothing is counted here, all is read when it is asked for."""

import re
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from mavkf.errors import EndpointError, UsageError
from mavkf.estimate import Status
from mavkf.link.framing import FrameCounts
from mavkf.service.fleet import Fleet
from mavkf.service.inbox import Inbox

if TYPE_CHECKING:
    from prometheus_client.core import Metric

_PLACE = re.compile(r"(?:(?P<host>[^\s:]+|\[[^\]\s]+\]):)?(?P<port>\d{1,5})")


def place(text: str) -> tuple[str, int]:
    """Host and port of `--metrics`. Raises UsageError."""
    match = _PLACE.fullmatch(text)
    if match is None or int(match["port"]) > 65_535:
        raise UsageError(f"--metrics {text}: give a port, as in 9464, or host:port to be reached from elsewhere")
    try:
        import prometheus_client  # noqa: F401
    except ImportError:
        raise UsageError("--metrics needs prometheus-client: pip install 'mavkf[metrics]'") from None
    return (match["host"] or "127.0.0.1").strip("[]"), int(match["port"])


class Metrics:
    """Serves `/metrics`; a context manager."""

    def __init__(
        self,
        where: tuple[str, int],
        fleet: Fleet,
        inbox: Inbox,
        links: Callable[[], Mapping[str, FrameCounts]],
        say: Callable[[str], None],
    ) -> None:
        """where: host and port, 0 for a free one; links: what came over each, by name. Raises EndpointError."""
        from prometheus_client import CollectorRegistry, start_http_server

        self._fleet, self._inbox, self._links = fleet, inbox, links
        registry = CollectorRegistry(auto_describe=False)
        registry.register(self)  # type: ignore[arg-type]
        try:
            self._server, self._thread = start_http_server(where[1], where[0], registry)
        except OSError as error:
            reason = error.strerror or str(error)
            raise EndpointError(
                f"--metrics {where[0]}:{where[1]} cannot be opened ({reason.lower()}): choose another port"
            ) from None
        say(f"metrics at http://{where[0]}:{self._server.server_port}/metrics")

    def close(self) -> None:
        """End it."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def collect(self) -> "Iterator[Metric]":
        """Every metric as it is now; called by the HTTP server."""
        yield from self._of_the_service()
        yield from self._of_vehicles()

    def _of_the_service(self) -> "Iterator[Metric]":
        from prometheus_client.core import CounterMetricFamily as Count
        from prometheus_client.core import GaugeMetricFamily as Gauge

        yield Gauge("mavkf_queue_bytes", "What has arrived and waits.", self._inbox.size)
        yield Gauge("mavkf_lag_seconds", "How far the work is behind the arrivals.", self._inbox.lag_us * 1e-6)
        yield Count("mavkf_chunks_dropped", "Pieces of telemetry for which there was no room.", self._inbox.dropped)
        unpublished = Count("mavkf_records_unpublished", "Records for which there was no time.", labels=["kind"])
        for kind in ("pose", "innovation"):
            unpublished.add_metric([kind], self._fleet.unpublished[kind])
        yield unpublished
        frames = Count("mavkf_frames", "MAVLink frames whose CRC holds.", labels=["link"])
        bad = Count("mavkf_frames_bad", "Frames whose CRC does not hold, or that were cut.", labels=["link"])
        for name, counts in self._links().items():
            frames.add_metric([name], counts.frames)
            bad.add_metric([name], counts.bad_crc + counts.truncated)
        yield frames
        yield bad

    def _of_vehicles(self) -> "Iterator[Metric]":
        from prometheus_client.core import CounterMetricFamily as Count
        from prometheus_client.core import GaugeMetricFamily as Gauge

        poses = Count("mavkf_poses", "Poses published.", labels=["vehicle"])
        silent = Gauge("mavkf_silent_seconds", "How long nothing has come of a vehicle.", labels=["vehicle"])
        rate = Gauge("mavkf_rate_hz", "Samples of an input, or poses, a second.", labels=["vehicle", "input"])
        valid = Gauge("mavkf_valid", "1 where a part of the estimate may be used.", labels=["vehicle", "part"])
        fused = Count("mavkf_measurements_fused", "In this session.", labels=["vehicle", "sensor"])
        refused = Count("mavkf_measurements_refused", "In this session.", labels=["vehicle", "sensor"])
        nis = Gauge("mavkf_nis", "Mean NIS of the last minute, 1 where right.", labels=["vehicle", "sensor"])
        for vehicle in list(self._fleet.vehicles.values()):
            status, name = vehicle.status, vehicle.name
            if status is None:
                continue
            poses.add_metric([name], vehicle.poses)
            silent.add_metric([name], self._fleet.silent_s(vehicle))
            _add(rate, name, status.rates_hz)
            _add(valid, name, {part: getattr(status.valid, part) for part in status.valid.__struct_fields__})
            _add(fused, name, _ending(status, "_fused"))
            _add(refused, name, _ending(status, "_refused"))
            _add(nis, name, {sensor: each.nis for sensor, each in status.innovations.items()})
        yield from (poses, silent, rate, valid, fused, refused, nis)


def _ending(status: Status, end: str) -> dict[str, int]:
    return {name.removesuffix(end): count for name, count in status.counts.items() if name.endswith(end)}


def _add(family: Any, vehicle: str, values: Mapping[str, float | None]) -> None:
    for name, value in values.items():
        if value is not None:
            family.add_metric([vehicle, name], float(value))
