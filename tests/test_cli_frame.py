"""The frame of the command line: help, errors, exit codes, interruption; and `watch` and `schema`, which are light."""

import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import mavkf
from mavkf.cli import COMMANDS, main
from mavkf.cli._screens import COLUMNS
from mavkf.cli._seen import Row
from mavkf.estimate import Pose
from mavkf.publish.publisher import Publisher
from mavkf.publish.records import decode
from mavkf.publish.session import open_session

from ._pose import POSE


def run(
    *arguments: str, code: str = "import sys; from mavkf.cli import main; sys.exit(main())"
) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_help_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    for words in ([], ["--help"], ["-h"]):
        assert main(words) == 0
        output = capsys.readouterr().out
        assert all(f"\n  {name} " in output for name in COMMANDS)
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.strip() == mavkf.__version__


@pytest.mark.parametrize("words", ["--help", "schema", "watch --help", "watch --seconds 0.2"])
def test_light_commands_import_nothing_heavy(rendezvous: str, words: str) -> None:
    code = (
        "import sys; from mavkf.cli import main; main(); "
        "print([name for name in ('numba', 'numpy', 'pymavlink', 'matplotlib') if name in sys.modules])"
    )
    output, _ = run(*words.split(), code=code).communicate(timeout=30)
    assert output.splitlines()[-1] == "[]"


def test_schema(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert set(json.loads(capsys.readouterr().out)["$defs"]) >= {"Pose", "Status", "Innovation", "Event"}


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("wacth", ["wacth", "watch", "replay"]),
        ("--foo", ["--foo", "replay"]),
        ("watch --jsn", ["--jsn", "--json", "--seconds"]),
        ("watch --seconds soon", ["--seconds", "soon", "float"]),
        ("watch --seconds", ["--seconds", "requires"]),
        ("watch --seconds=-1", ["--seconds", "above 0"]),
        ("watch --seconds nan", ["--seconds", "above 0"]),
        ("watch one two", ["two", "watch --help"]),
        ("watch a/b", ["a/b", "letters"]),
        ("watch --connect here", ["--connect", "here", "tcp/"]),
        ("watch --listen here", ["--listen", "here", "tcp/"]),
        ("watch --zenoh-config none.json5", ["--zenoh-config", "none.json5", "JSON5"]),
    ],
)
def test_wrong_usage_is_one_sentence_that_says_what_would_be_right(
    rendezvous: str, words: str, named: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words.split()) == 2
    output, message = capsys.readouterr()
    assert output == ""
    assert message.startswith("mavkf: ")
    assert message.count("\n") == 1
    assert all(word in message for word in named)


def test_an_unusable_endpoint_is_exit_1(rendezvous: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--listen", "tcp/192.0.2.123:7447"]) == 1
    assert "--listen tcp/192.0.2.123:7447" in capsys.readouterr().err


def test_watch_without_a_pose_is_exit_1(rendezvous: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["watch", "--seconds", "0.2"]) == 1
    assert "mavkf serve" in capsys.readouterr().err


def test_watch_once(rendezvous: str, capsys: pytest.CaptureFixture[str]) -> None:
    with open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
        publisher.publish(POSE)
        assert main(["watch", "1-1", "--json", "--once", "--seconds", "20"]) == 0
        assert decode("pose", capsys.readouterr().out.encode()) == POSE
        assert main(["watch", "--once", "--seconds", "20"]) == 0
        line = capsys.readouterr().out
        for part in ("1-1", "navigating", "position tilt", "47.3977421", "1.0 -2.0 -", "still"):
            assert part in line


def test_watch_that_was_first_shows_a_table_in_a_terminal(rendezvous: str) -> None:
    screen, terminal = pty.openpty()
    command = "import sys; from mavkf.cli import main; sys.exit(main())"
    process = subprocess.Popen(
        [sys.executable, "-c", command, "watch"],
        stdout=terminal,
        stderr=terminal,
        env=os.environ | {"COLUMNS": "200", "TERM": "xterm"},
    )
    os.close(terminal)

    def read_until(text: bytes) -> None:
        seen = b""
        while text not in seen:
            seen += os.read(screen, 65536)

    try:
        read_until(b"waiting")
        with open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
            assert publisher.wait_for_subscriber(20)
            publisher.publish(POSE)
            read_until(b"47.3977421")
        process.send_signal(signal.SIGINT)
        with pytest.raises(OSError):  # the terminal's way to say that the process has ended
            read_until(b"Traceback")
        assert process.wait(timeout=10) == 130
    finally:
        process.kill()
        process.wait()
        os.close(screen)


@pytest.mark.parametrize(
    ("end", "code"), [(lambda p: p.send_signal(signal.SIGINT), 130), (lambda p: p.stdout.close(), 141)]
)
def test_interruption_and_a_closed_pipe_end_at_once_and_quietly(
    rendezvous: str, end: Callable[[subprocess.Popen[str]], None], code: int
) -> None:
    with open_session(publishes=True) as session, Publisher(session, "1-1") as publisher:
        process = run("watch", "--json")
        assert process.stdout is not None and process.stderr is not None
        assert publisher.wait_for_subscriber(20)
        publisher.publish(POSE)
        process.stdout.readline()
        begin = time.monotonic()
        end(process)
        publisher.publish(POSE)
        assert process.wait(timeout=10) == code
        assert time.monotonic() - begin < 5.0
        assert process.stderr.read() == ""
        process.stderr.close()
        process.stdout.close()


def test_what_a_row_says() -> None:
    row = Row("1-1", 100.0)
    row.take(POSE, 100.0)
    texts = {name: column.text(row) for name, column in COLUMNS.items()}
    assert (texts["\u03c3 h m"], texts["\u03c3 v"], texts["\u03c3 yaw"]) == ("5.00", "0.50", "-")
    assert texts["v NED m/s"] == "-"
    row.take(Pose(vehicle="1-1", session=0, seq=57), 101.0)
    assert COLUMNS["Hz"].text(row) == "50"
    row.take(Pose(vehicle="1-1", session=1, seq=0), 101.5)
    assert COLUMNS["Hz"].text(row) == "0"
    assert COLUMNS["valid"].text(row) == "nothing"


def test_every_command_that_is_there_is_a_documented_function() -> None:
    """By source, so that this test imports nothing heavy; a command still to come is passed over."""
    folder = Path(mavkf.__file__).parent / "cli"
    for name in COMMANDS:
        path = folder / f"{name}.py"
        if path.exists():
            assert f"\ndef {name}(" in path.read_text()
