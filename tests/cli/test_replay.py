import json
from pathlib import Path

import pytest

from mavkf.cli import main
from mavkf.service.warmup import flight


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.tlog"
    path.write_bytes(b"".join(stamp.to_bytes(8, "big") + frame for stamp, frame in flight()))
    return path


@pytest.mark.parametrize("option", ["--csv", "--jsonl"])
def test_the_log_itself_is_never_written_over(log: Path, option: str, capsys: pytest.CaptureFixture[str]) -> None:
    before = log.read_bytes()
    assert main(["replay", str(log), option, str(log.parent / "." / log.name)]) == 2
    assert "is the log itself" in capsys.readouterr().err
    assert log.read_bytes() == before


def test_where_to_publish_without_publishing_is_wrong_usage(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log), "--connect", "tcp/127.0.0.1:9"]) == 2
    assert "--publish" in capsys.readouterr().err


def test_a_span_without_samples_is_said(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log), "--from", "500"]) == 1
    assert "--from" in capsys.readouterr().err


def test_a_wrong_path_is_said_before_anything_is_compiled(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mavkf.cli.replay.compile_first", lambda **_: pytest.fail("compiled first"))
    assert main(["replay", str(tmp_path / "nothere.tlog")]) == 1
    assert "does not exist" in capsys.readouterr().err


def test_smoothing_as_live_is_wrong_usage(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(log), "--smooth", "--as-live"]) == 2
    assert "--smooth" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--form", "ud", "--as-live"], "leave --as-live"),
        (["--update", "iterated", "--as-live"], "leave --as-live"),
        (["--form", "ud", "--smooth"], "leave --form"),
        (["--form", "cholesky"], "square-root-information"),
        (["--update", "third"], "second-order"),
    ],
)
def test_forms_and_orders_that_cannot_be(
    log: Path, options: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["replay", str(log), *options]) == 2
    assert said in capsys.readouterr().err


def test_the_summary_names_form_order_and_model(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["replay", str(log), "--form", "ud", "--update", "iterated", "--model", "constant-velocity"]
    main([*options, "--json"])
    (session,) = json.loads(capsys.readouterr().out)["sessions"]
    told = session["filter"]
    assert (told["form"], told["order"], told["model"]) == ("ud", "iterated", "constant-velocity")
    assert told["prediction_us"] > 0.0
    assert told["update_us"] > 0.0
    main(options)
    assert "form ud, order iterated, model constant-velocity" in capsys.readouterr().out
    main(["replay", str(log), "--json"])
    assert json.loads(capsys.readouterr().out)["sessions"][0]["filter"] is None
