"""Metrics over HTTP, in the format of Prometheus."""

import socket
import time
import urllib.request
from collections.abc import Callable

import pytest
from prometheus_client.parser import text_string_to_metric_families

from mavkf.cli import main

from .conftest import Frames, Reader, Serve, has_pose_at

ORDER = ("vehicle", "input", "part", "sensor", "link", "kind")


def scrape(url: str) -> dict[tuple[str, ...], float]:
    """Values by name and labels."""
    with urllib.request.urlopen(url, timeout=10) as answer:
        text = answer.read().decode()
    return {
        (sample.name, *(sample.labels[name] for name in ORDER if name in sample.labels)): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }


def test_metrics_say_what_was_published_and_heard(serve: Callable[..., Serve], reader: Reader, flight: Frames) -> None:
    process = serve("udpin:127.0.0.1:0", "--no-request", "--metrics", "0")
    url = process.line("metrics at").split()[-1]
    port = int(process.line("listens on").rsplit(":", 1)[1])
    assert "127.0.0.1" in url
    reader.wait_for_publisher()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", port))
        for _, frame in flight:
            out.send(frame)
            time.sleep(0.0005)  # the pace of the sender
        out.send(b"\xfd" + flight[0][1][1:-1] + b"?")
    published = reader.wait(has_pose_at(20.9))
    deadline = time.monotonic() + 10.0
    while (found := scrape(url))["mavkf_frames_bad_total", "udpin:127.0.0.1:0"] < 1.0:
        assert time.monotonic() < deadline
    assert found["mavkf_poses_total", "1-1"] == len(published["mavkf/1-1/pose"])
    assert found["mavkf_frames_total", "udpin:127.0.0.1:0"] == len(flight)
    assert found["mavkf_rate_hz", "1-1", "imu"] == pytest.approx(50.0, abs=1.0)
    assert found["mavkf_valid", "1-1", "position"] == 1.0
    status = published["mavkf/1-1/status"][-1]
    assert found["mavkf_measurements_fused_total", "1-1", "gnss_position"] == status["counts"]["gnss_position_fused"]
    assert found["mavkf_nis", "1-1", "gnss_position"] == pytest.approx(status["innovations"]["gnss_position"]["nis"])
    assert found["mavkf_chunks_dropped_total",] == found["mavkf_queue_bytes",] == 0.0
    assert found["mavkf_records_unpublished_total", "pose"] == 0.0
    assert 0.0 <= found["mavkf_silent_seconds", "1-1"] < 10.0
    assert process.interrupt() == 130


@pytest.mark.parametrize("text", ["", "here", "127.0.0.1:", "70000", "a b:1"])
def test_a_place_that_is_none_is_one_sentence(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["serve", "udpin:127.0.0.1:0", "--metrics", text]) == 2
    assert "give a port" in capsys.readouterr().err


def test_a_port_in_use_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as holder:
        port = holder.getsockname()[1]
        assert main(["serve", "udpin:127.0.0.1:0", "--metrics", str(port), "--quiet"]) == 1
    assert f"--metrics 127.0.0.1:{port} cannot be opened" in capsys.readouterr().err
