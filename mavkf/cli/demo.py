"""`mavkf demo`: a simulated flight, served by one process and watched by another, with the error against truth at the end."""

import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mavkf.cli._console import compile_first, output, say
from mavkf.errors import InputError, MavkfError, UsageError
from mavkf.estimate import Pose
from mavkf.publish.subscriber import Subscription, subscribe

if TYPE_CHECKING:
    from rich.table import Table

    from mavkf.replay.truth import Truth

NAME = "demo"  # in the keys, so that no real vehicle on this machine is mistaken for it
SETTLED_S = 20.0  # s after the first position, from when on errors are counted
SHOWN = (
    ("horizontal_m", "horizontal", "m"),
    ("down_m", "down", "m"),
    ("vn_ms", "velocity north", "m/s"),
    ("ve_ms", "velocity east", "m/s"),
    ("vd_ms", "velocity down", "m/s"),
    ("tilt_deg", "tilt", "deg"),
    ("yaw_deg", "yaw", "deg"),
)


def demo(*, seed: int = 1, duration: float = 120.0, speed: float = 10.0, plot: Path | None = None) -> int:
    """Fly a simulated flight, serve it, watch it through zenoh from a second process, and compare with the truth.

    Needs nothing: no autopilot, no log, no set-up. Ends with the errors and a picture of them.

    Args:
        seed: Draws the route and all sensor errors.
        duration: Seconds of flight, at least 60.
        speed: Times real time.
        plot: Picture to write; mavkf-demo.png if not given.

    """
    if not 0.0 < speed < math.inf:
        raise UsageError(f"--speed {speed:g}: give times real time, above 0")
    from mavkf.replay.simulation import simulate

    compile_first()
    with tempfile.TemporaryDirectory(prefix="mavkf-demo-") as folder:
        log = Path(folder) / "demo.tlog"
        say(f"flying {duration:g} s of a simulated copter (seed {seed})")
        truth = simulate(log, seed=seed, duration_s=duration)
        poses = _watch(log, truth, speed)
    if not poses:
        raise InputError("no pose came from the service; see what it said above")
    return _conclude(poses, truth, plot)


def _watch(log: Path, truth: "Truth", speed: float) -> list[Pose]:
    """Serve the log from a second process and collect its poses, showing them."""
    command = [sys.executable, "-m", "mavkf", "serve", str(log), "--speed", f"{speed:g}", "--wait-subscriber", "30"]
    command += ["--vehicle-name", f"1-1={NAME}", "--quiet"]
    poses: list[Pose] = []
    with subscribe(NAME) as subscription, subprocess.Popen(command, stdout=subprocess.DEVNULL) as server:
        say(
            f"serving it at {speed:g} times its pace: process {server.pid} publishes mavkf/{NAME}/pose, this one subscribes"
        )
        try:
            with _shown(truth) as show:
                for pose in _until_end(subscription, server):
                    poses.append(pose)
                    show(pose)
        finally:
            server.terminate()
    return poses


def _until_end(subscription: Subscription[Pose], server: "subprocess.Popen[bytes]") -> Iterator[Pose]:
    """Poses until the server has ended and nothing more comes."""
    while True:
        ended = server.poll() is not None
        pose = subscription.receive(0.3)
        if pose is not None:
            yield pose
        elif ended:
            return


@contextmanager
def _shown(truth: "Truth") -> Iterator[Callable[[Pose], None]]:
    """Show poses as they come: a live table in a terminal, else a line now and then."""
    console = output()
    last = -math.inf

    def due(every: float) -> bool:
        nonlocal last
        now = time.monotonic()
        if now - last < every:
            return False
        last = now
        return True

    if console.is_terminal:
        from rich.live import Live

        with Live(console=console, auto_refresh=False) as live:
            yield lambda pose: live.update(_table(pose, truth), refresh=True) if due(0.1) else None
        return
    yield lambda pose: print(_line(pose, truth), flush=True) if due(2.0) else None


def _against(pose: Pose, truth: "Truth") -> str:
    """Position error of one pose in words."""
    import numpy as np

    from mavkf.replay.truth import errors

    if pose.lat_deg is None or pose.lon_deg is None or pose.alt_amsl_m is None:
        return "position not known yet"
    estimate = {
        "time_boot_s": np.array([pose.t_boot_s]),
        "lat_deg": np.array([pose.lat_deg]),
        "lon_deg": np.array([pose.lon_deg]),
        "alt_amsl_m": np.array([pose.alt_amsl_m]),
    }
    try:
        values = errors(estimate, truth).values
    except InputError:  # outside the truth's time
        return ""
    covariance = pose.pose_covariance or ()
    sigma = math.sqrt((covariance[0] or 0.0) + (covariance[7] or 0.0)) if covariance else math.nan
    return f"{values['horizontal_m'][0]:.2f} m off, {sigma:.2f} m claimed"


def _columns_of(pose: Pose) -> tuple[str, ...]:
    vector = "{:.1f} {:.1f} {:.1f}".format
    angles = (
        "not known" if pose.euler_deg is None else " ".join("?" if a is None else f"{a:.1f}" for a in pose.euler_deg)
    )
    return (
        f"{pose.t_boot_s:.2f}",
        pose.mode.value,
        vector(*pose.position_ned_m) if pose.position_ned_m else "",
        vector(*pose.velocity_ned_m_s) if pose.velocity_ned_m_s else "",
        angles,
    )


def _line(pose: Pose, truth: "Truth") -> str:
    t, mode, position, velocity, angles = _columns_of(pose)
    return f"{t:>7} s  {mode:<10} NED {position or '-':<20} m  v {velocity or '-':<16} m/s  rpy {angles:<18} deg  {_against(pose, truth)}"


def _table(pose: Pose, truth: "Truth") -> "Table":
    from rich.table import Table

    table = Table(title=f"mavkf/{NAME}/pose, number {pose.seq}")
    for name in ("boot time, s", "mode", "north east down, m", "velocity, m/s", "roll pitch yaw, deg", "against truth"):
        table.add_column(name)
    table.add_row(*_columns_of(pose), _against(pose, truth))
    return table


def _conclude(poses: list[Pose], truth: "Truth", plot: Path | None) -> int:
    """Print the errors against the truth and write the picture."""
    from mavkf.replay.export import pose_columns
    from mavkf.replay.plot import plot_errors
    from mavkf.replay.truth import errors

    estimate = pose_columns(poses)
    first = next((pose.t_boot_s for pose in poses if pose.position_ned_m is not None), None)
    if first is None:
        raise InputError("the service never found a position; try another --seed")
    numbers = [pose.seq for pose in poses]
    lost = numbers[-1] - numbers[0] + 1 - len(numbers)
    found = errors(estimate, truth, begin=first + SETTLED_S)
    print(f"\n{len(poses)} poses came through zenoh, {lost} were lost")
    print(f"errors against the truth from {first + SETTLED_S:.0f} s on:")
    print(f"{'':16}{'rms':>9}{'p95':>9}{'max':>9}    error/sigma (rms; 1 is honest)")
    for name, label, unit in SHOWN:
        if name in found.statistics:
            s = found.statistics[name]
            print(f"{label:<16}{s.rms:9.3f}{s.p95:9.3f}{s.max:9.3f} {unit:<4}{s.error_over_sigma:6.2f}")
    path = plot or Path("mavkf-demo.png")
    try:
        plot_errors(path, estimate, truth, "mavkf demo: a simulated flight, estimated live")
    except MavkfError as error:
        if plot is not None:
            raise
        say(str(error))  # the demo itself has succeeded
    else:
        print(f"picture: {path}")
    return 0
