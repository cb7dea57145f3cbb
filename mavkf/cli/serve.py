"""`mavkf serve`: live telemetry or logs in, fused poses over zenoh out."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

from cyclopts import Parameter

from mavkf.cli._console import Connect, Listen, ZenohConfig, compile_first, say
from mavkf.cli._signals import Signals
from mavkf.errors import UsageError

if TYPE_CHECKING:
    from mavkf.service.endpoints import Link

LONGEST_LAG_S = 60.0
Repeated = Parameter(show_default=False)


def serve(  # noqa: D417 (the rest is described in _console)
    *sources: str,
    speed: float = 1.0,
    wait_subscriber: float | None = None,
    record: Path | None = None,
    record_mb: float = 1024.0,
    record_hours: float = 24.0,
    request: Annotated[bool | None, Parameter(negative="--no-request", show_default=False)] = None,
    link_share: float = 0.5,
    source_system: int | None = None,
    source_component: int = 191,
    allow: Annotated[tuple[str, ...], Repeated] = (),
    signing_key: str | None = None,
    allow_unsigned: bool = False,
    rate: float = 50.0,
    smooth_lag: float = 0.0,
    vehicle_name: Annotated[tuple[str, ...], Repeated] = (),
    imu: str | None = None,
    model: str | None = None,
    config: Path | None = None,
    print_config: bool = False,
    set: Annotated[tuple[str, ...], Repeated] = (),
    encoding: str = "json",
    control: bool = False,
    metrics: str | None = None,
    mavlink_out: str | None = None,
    connect: Connect = (),
    listen: Listen = (),
    zenoh_config: ZenohConfig = None,
    quiet: bool = False,
) -> int:
    """Read live telemetry or a log, estimate, publish over zenoh.

    SOURCE is one of udpin:HOST:PORT (listen for datagrams), udpout:HOST:PORT (send datagrams there first, and listen for the
    answers), tcp:HOST:PORT (connect to a server), tcpin:HOST:PORT (be the server, for one connection at a time),
    serial:PATH:BAUD (a serial port), zenoh:KEY (raw MAVLink frames on a zenoh key, as mavlink_raw/out), stdin (raw MAVLink from
    standard input), or a log (.tlog). Several links, or several logs, at once.

    Runs until the end of the log, or Ctrl-C. Exit code 0 when a log was served, 1 when nothing could be estimated, 130
    after Ctrl-C, 0 after SIGTERM.

    Args:
        sources: Where telemetry comes from, as above.
        speed: Of logs: times the recorded pace, 0 for as fast as possible.
        wait_subscriber: Of logs: wait so many seconds for the first subscriber, and from then on rather wait than drop.
        record: Folder to record what comes in, a tlog for each source.
        record_mb: Megabytes of a recording after which the next file is begun.
        record_hours: Hours after which the next file is begun.
        request: Of links: ask the vehicle for the streams that are needed, over a radio too, or never ask and send nothing at all.
            Without either it asks over this machine and its own networks only.
        link_share: The share of a serial port's or a distant link's bytes that may be asked for, 0 to 1.
        source_system: Our MAVLink system id; that of the vehicle if not given.
        source_component: Our MAVLink component id; 191 is an onboard computer.
        allow: Of links: believe these system ids only, as in 1,2; may be repeated.
        signing_key: Of links: MAVLink 2 signing by the key in this file, 64 hex digits, or a passphrase: frames that are not
            signed with it are refused, ours are signed.
        allow_unsigned: Take frames without a signature all the same.
        smooth_lag: Publish mavkf/<vehicle>/pose/smoothed too, each pose by what came in so many seconds after it.
        rate: Poses a second of the vehicle's clock; 0 for one each IMU sample.
        vehicle_name: SYSID-COMPID=NAME, as in 1-1=alpha: call this vehicle so in keys and records; may be repeated.
        imu: IMU message to use, as in RAW_IMU; chosen from the first seconds if not given.
        model: strapdown, telemetry or constant-velocity; chosen from the first seconds if not given.
        config: TOML file of settings, and in its table [serve] of sources and of these options; the command line comes first.
        print_config: Print such a file, with all that holds now and what it means, and end.
        set: key=value, one setting; may be repeated.
        encoding: json or msgpack.
        control: Of links: let others reset the estimate and change its settings, by queries on mavkf/VEHICLE/@ctl/reset and
            .../config.
        metrics: Of links: PORT, or HOST:PORT, at which Prometheus finds metrics; a port alone is reached from this machine only.
        mavlink_out: Of links: send the poses as ODOMETRY to the vehicle (vehicle) or to an endpoint, as in udpout:127.0.0.1:14560.
            They rest on the vehicle's own GNSS: an autopilot that fuses that as well counts it twice.
        quiet: Say only what goes wrong.

    """
    from mavkf.cli import make_app
    from mavkf.cli._config_file import sources as config_sources
    from mavkf.cli._config_file import written
    from mavkf.config import Config, read_config, with_settings
    from mavkf.publish.records import Encoding, check_choice
    from mavkf.publish.session import open_session, publishing_session
    from mavkf.service.endpoints import source

    if config is not None:
        of_file = config_sources(config)
        sources = sources or of_file
    if print_config:
        given = dict(locals())
        values = with_settings(read_config(config) if config else Config(), set)
        print(written(make_app()["serve"].assemble_argument_collection(parse_docstring=True), given, values), end="")
        return 0
    if not sources:
        raise UsageError(
            "serve needs a source: udpin:HOST:PORT, tcp:HOST:PORT or another (--help), or the path of a log"
        )
    if not 0.0 <= speed < math.inf:
        raise UsageError(f"--speed {speed:g}: give times the recorded pace, or 0 for as fast as possible")
    if wait_subscriber is not None and not 0.0 <= wait_subscriber < math.inf:
        raise UsageError(f"--wait-subscriber {wait_subscriber:g}: give seconds")
    if not 0.0 <= smooth_lag <= LONGEST_LAG_S:
        raise UsageError(
            f"--smooth-lag {smooth_lag:g}: give seconds, at most {LONGEST_LAG_S:g}: a whole flight is what replay --smooth is for"
        )
    if not 0.0 <= rate <= 10_000.0:
        raise UsageError(f"--rate {rate:g}: give poses a second, or 0 for one each IMU sample")
    check_choice("encoding", encoding, Encoding)
    if not (record_mb > 0.0 and record_hours > 0.0):
        raise UsageError("--record-mb and --record-hours: give sizes above 0")
    names = _names(vehicle_name)
    settings = with_settings(read_config(config) if config else Config(), set)
    zenoh_session = partial(open_session, publishes=False, connect=connect, config_file=zenoh_config)
    opened = [source(text, _whisper if quiet else say, zenoh_session) for text in sources]
    logs = [one for one in opened if isinstance(one, Path)]
    links = [one for one in opened if not isinstance(one, Path)]
    if logs and links:
        raise UsageError(f"{logs[0]} is a log and {links[0].name} is live: serve them by two commands")
    if logs and (control or metrics is not None or mavlink_out is not None):
        raise UsageError("--control, --metrics and --mavlink-out are for live telemetry")
    if links and wait_subscriber is not None:
        raise UsageError("--wait-subscriber is for logs: live telemetry waits for nobody")
    if links and speed != 1.0:
        raise UsageError("--speed is for logs: live telemetry has its own pace")
    if logs and (request is not None or allow or signing_key is not None):
        raise UsageError(
            "--request, --no-request, --allow and --signing-key are for live telemetry: a log is taken as it is"
        )
    systems = _systems(allow)
    _check_talk(link_share, source_system, source_component)
    if request is False and any(link.speaks_first for link in links):
        raise UsageError("--no-request sends nothing, and what answers a udpout: is silent until then: use udpin:")
    feedback = _feedback(mavlink_out, _whisper if quiet else say)
    if request is False and feedback == "vehicle":
        raise UsageError("--no-request sends nothing to the vehicle: leave it out, or give --mavlink-out an endpoint")
    if allow_unsigned and signing_key is None:
        raise UsageError("--allow-unsigned is about --signing-key: without a key signatures are not looked at")

    from mavkf.navigation.setup import MODELS
    from mavkf.replay.options import imu_source
    from mavkf.service.belief import Belief
    from mavkf.service.fleet import Options
    from mavkf.service.metrics import place
    from mavkf.service.server import Records, serve_links, serve_logs
    from mavkf.service.signing import Signing, read_key
    from mavkf.service.talk import Manners

    if model is not None and model not in MODELS:
        raise UsageError(f"--model {model}: choose one of {', '.join(MODELS)}")
    imu_message = imu_source(imu)
    signing = Signing(read_key(signing_key), say, allow_unsigned=allow_unsigned) if signing_key is not None else None
    compile_first(smoothing=smooth_lag > 0.0)
    options = Options(
        rate_hz=rate,
        lag_s=smooth_lag,
        imu=imu_message,
        model=model,
        config=settings,
        names=names,
        encoding=next(known for known in get_args(Encoding) if known == encoding),
        congestion="drop" if wait_subscriber is None else "block",
        quiet=quiet,
        control=control,
        metrics=place(metrics) if metrics is not None else None,
    )
    recordings = Records(record, record_mb * 1e6, record_hours * 3600.0) if record is not None else None
    with (
        Signals(may_block=wait_subscriber is not None) as signals,
        publishing_session(
            listen=listen, connect=connect, config_file=zenoh_config, stopped=signals.stopped
        ) as session,
    ):
        if links:
            poses = serve_links(
                links,
                session,
                options,
                say=say,
                stopped=signals.stopped,
                belief=Belief(signing=signing, systems=systems, say=say),
                manners=Manners(
                    system=source_system,
                    component=source_component,
                    request=request,
                    share=link_share,
                    signing=signing,
                    say=_whisper if quiet else say,
                ),
                record=recordings,
                feedback=feedback,
            )
        else:
            poses = serve_logs(
                logs,
                session,
                options,
                say=say,
                stopped=signals.stopped,
                record=recordings,
                speed=speed,
                wait_subscriber_s=wait_subscriber,
            )
    if signals.received is not None:
        return signals.exit_code()
    if poses == 0:
        say("nothing could be estimated: neither a 3D fix nor a usable IMU was among the messages")
        return 1
    if not quiet:
        say(f"{poses} poses were published")
    return 0


def _whisper(text: str) -> None:
    """Say nothing."""


def _feedback(text: str | None, tell: Callable[[str], None]) -> "Link | Literal['vehicle'] | None":
    """Where `--mavlink-out` sends to."""
    from mavkf.service.endpoints import Link, source

    if text is None or text == "vehicle":
        return "vehicle" if text else None
    to = source(text, tell)
    if not isinstance(to, Link):
        raise UsageError(f"--mavlink-out {text}: give an endpoint, as in udpout:127.0.0.1:14560, or vehicle")
    return to


def _systems(allow: tuple[str, ...]) -> frozenset[int] | None:
    """The system ids of `--allow 1,2`; None: all."""
    ids = [word.strip() for text in allow for word in text.split(",")]
    if not all(word.isascii() and word.isdigit() and 1 <= int(word[:9]) <= 255 for word in ids):
        raise UsageError(f"--allow {','.join(ids)}: give MAVLink system ids from 1 to 255, as in 1,2")
    return frozenset(map(int, ids)) or None


def _check_talk(share: float, system: int | None, component: int) -> None:
    if not 0.0 < share <= 1.0:
        raise UsageError(f"--link-share {share:g}: give a share above 0, at most 1")
    for option, number in (("--source-system", system), ("--source-component", component)):
        if number is not None and not 1 <= number <= 255:
            raise UsageError(f"{option} {number}: give a MAVLink id from 1 to 255")


def _names(assignments: tuple[str, ...]) -> dict[str, str]:
    import re

    from mavkf.publish.records import check_name

    names: dict[str, str] = {}
    for assignment in assignments:
        match = re.fullmatch(r"(\d{1,3}-\d{1,3})=(.+)", assignment)
        if match is None:
            raise UsageError(f"--vehicle-name {assignment}: expected SYSID-COMPID=NAME, as in 1-1=alpha")
        if match[2] in names.values():
            raise UsageError(f"--vehicle-name {assignment}: two vehicles cannot have one name")
        names[match[1]] = check_name(match[2])
    return names
