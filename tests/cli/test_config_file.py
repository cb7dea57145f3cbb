"""The configuration file of `mavkf serve`: what is read from it, and what `--print-config` writes."""

import tomllib
from pathlib import Path
from typing import Any

import pytest

from mavkf.cli import main
from mavkf.config import Config, read_config, settings
from mavkf.service import server, warmup


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the service would have been given."""
    found: dict[str, Any] = {}

    def serve_links(links: Any, session: Any, options: Any, **more: Any) -> int:
        found.update(more, names=[link.name for link in links], options=options)
        return 1

    monkeypatch.setattr(server, "serve_links", serve_links)
    monkeypatch.setattr(warmup, "ensure_compiled", lambda _, **__: 0.0)
    return found


FILE = """
[serve]
sources = ["udpin:127.0.0.1:0", "tcp:127.0.0.1:5760"]
rate = 20
record-mb = 12.5
record = "{folder}"
request = false
allow = ["1,2", "7"]
vehicle_name = ["1-1=alpha"]
quiet = true
[noise]
gyro = 2e-4
"""


def test_sources_options_and_settings_come_from_the_file(served: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "mavkf.toml"
    path.write_text(FILE.replace("{folder}", str(tmp_path)))
    assert main(["serve", "--config", str(path)]) == 0
    assert served["names"] == ["udpin:127.0.0.1:0", "tcp:127.0.0.1:5760"]
    options = served["options"]
    assert (options.rate_hz, options.quiet, options.names) == (20.0, True, {"1-1": "alpha"})
    assert options.config.noise.gyro == 2e-4
    assert served["record"] == server.Records(tmp_path, 12.5e6, 24 * 3600.0)
    assert served["manners"].request is False
    assert served["belief"]._systems == {1, 2, 7}


def test_the_command_line_comes_first(served: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "mavkf.toml"
    path.write_text(FILE.replace("{folder}", str(tmp_path)))
    words = ["udpin:127.0.0.1:1", "--rate", "5", "--request", f"--config={path}", "--allow", "3", "--set", "gyro=1e-3"]
    assert main(["serve", *words]) == 0
    assert served["names"] == ["udpin:127.0.0.1:1"]
    assert (served["options"].rate_hz, served["manners"].request, served["belief"]._systems) == (5.0, True, {3})
    assert served["options"].config.noise.gyro == 1e-3


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[serve]\nrates = 3", ["rates", "--rate", "mavkf.toml"]),
        ('[serve]\nrate = "fast"', ["rate", "fast", "mavkf.toml"]),
        ("[serve]\nsources = 3", ["sources", "list"]),
        ('[serve]\nset = ["gyro=1"]', ["set", "tables of their own"]),
        ("serve = 3", ["table"]),
        ("[serve", ["not TOML"]),
        ("[noise]\ngyros = 3", ["gyros"]),
    ],
)
def test_what_is_wrong_in_a_file_is_one_sentence(
    text: str, named: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "mavkf.toml"
    path.write_text(text)
    assert main(["serve", "udpin:127.0.0.1:0", "--config", str(path)]) == 2
    (message,) = capsys.readouterr().err.splitlines()
    assert all(part in message for part in named)


def test_a_printed_file_says_everything_and_reads_back(
    served: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--print-config"]) == 0
    text = capsys.readouterr().out
    path = tmp_path / "mavkf.toml"
    path.write_text(text)
    assert read_config(path) == Config()
    for name, *_ in settings():
        assert name.split(".")[1] in text
    for part in (
        "# Folder to record what comes in",
        "# s: a sample this much older than the newest",
        "# signing_key =",
    ):
        assert part in text
    assert main(["serve", "udpin:127.0.0.1:0", "--config", str(path)]) == 0
    by_file = dict(served)
    assert main(["serve", "udpin:127.0.0.1:0"]) == 0
    assert by_file["options"] == served["options"]

    words = ["udpin:127.0.0.1:9", "--set", "gyro=3e-4", "--record", 'a"b', "--signing-key", "secret"]
    assert main(["serve", *words, "--print-config"]) == 0
    text = capsys.readouterr().out
    found = tomllib.loads(text)
    assert found["serve"]["sources"] == ["udpin:127.0.0.1:9"]
    assert (found["serve"]["record"], found["noise"]["gyro"]) == ('a"b', 3e-4)
    assert "secret" not in text
