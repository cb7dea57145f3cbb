"""Who may read and who may act: `--control`, and zenoh's own TLS and access control with the examples of deploy/."""

import json
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import trustme
import zenoh

from mavkf.publish.session import open_session
from mavkf.publish.subscriber import subscribe

from .conftest import Frames, Reader, Serve, expected, has_pose_at, without_utc

Start = Callable[..., Serve]
EXAMPLES = Path(__file__).parents[2] / "deploy" / "zenoh"


def ask(session: zenoh.Session, action: str, text: str = "", vehicle: str = "1-1") -> list[str]:
    """What is answered; an error begins with "error"."""
    replies = session.get(f"mavkf/{vehicle}/@ctl/{action}", payload=text or None, timeout=5.0)
    answers = []
    for reply in replies:
        if reply.ok is not None:
            answers.append(reply.ok.payload.to_string())
        elif reply.err is not None:
            answers.append("error " + reply.err.payload.to_string())
    return answers


@contextmanager
def sender(process: Serve) -> Iterator[Callable[[Frames], None]]:
    """Sends frames to a service that listens."""
    port = int(process.line("listens on").rsplit(":", 1)[1])
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.connect(("127.0.0.1", port))

        def send(frames: Frames) -> None:
            for _, frame in frames:
                out.send(frame)
                time.sleep(0.0005)  # the pace of the sender

        yield send


def test_a_reset_on_request_can_be_repeated_from_the_recordings(
    serve: Start, reader: Reader, flight: Frames, tmp_path: Path
) -> None:
    process = serve("udpin:127.0.0.1:0", "--no-request", "--control", "--record", tmp_path)
    with sender(process) as send, open_session(publishes=False) as session:
        reader.wait_for_publisher()
        send(flight[:900])
        reader.wait(has_pose_at(9.0))
        settings = json.loads(ask(session, "config")[0])
        assert settings["noise"]["gyro"] == 1e-4
        assert ask(session, "reset") == ['{"session":1}']
        send(flight[900:1400])
        reader.wait(has_pose_at(14.0))
        assert ask(session, "config", "noise.gyro=3e-4\nvehicle.use_barometer=false") == ['{"session":2}']
        assert json.loads(ask(session, "config")[0])["noise"]["gyro"] == 3e-4
        (error,) = ask(session, "config", "noise.gyro=-1")
        assert error.startswith("error") and "noise.gyro=-1" in error
        (error,) = ask(session, "reset", vehicle="7-1")
        assert "1-1" in error
        assert "reset and config" in ask(session, "land")[0]
        assert "name one vehicle" in ask(session, "reset", vehicle="*")[0]
    assert process.interrupt() == 130
    parts = sorted(tmp_path.iterdir(), key=lambda path: path.read_bytes()[:8])
    assert len(parts) == 2
    found = without_utc(reader.published)
    for session_number, part in enumerate(parts):
        wanted = without_utc(expected(part))
        assert len(wanted["mavkf/1-1/pose"]) > 100
        for key, records in wanted.items():
            mine = [
                record for record in found[key] if record["session"] == session_number and record.get("kind") != "reset"
            ]
            assert mine == [record | {"session": session_number} for record in records]
    assert [event["session"] for event in found["mavkf/1-1/event"] if event["kind"] == "reset"] == [0, 1]


def test_without_control_nobody_can_act(serve: Start, reader: Reader, flight: Frames) -> None:
    process = serve("udpin:127.0.0.1:0", "--no-request")
    with sender(process) as send, open_session(publishes=False) as session:
        reader.wait_for_publisher()
        send(flight[:300])
        reader.wait(lambda published: "mavkf/1-1/status" in published)
        assert ask(session, "reset") == []
    assert process.interrupt() == 130


class Keys:
    """A certificate authority, what it signed, and configuration files that name them: the examples with other paths."""

    def __init__(self, folder: Path, port: int) -> None:
        self.folder, self.port = folder, port
        authority, stranger = trustme.CA(), trustme.CA()
        authority.cert_pem.write_to_path(folder / "ca.pem")
        for signer, name in ((authority, "serve"), (authority, "reader"), (authority, "operator"), (stranger, "wrong")):
            # as the name of whom it is for, beside the address at which the service is reached
            leaf = signer.issue_cert("127.0.0.1", "localhost", common_name=name)
            (folder / f"{name}.key").write_bytes(leaf.private_key_pem.bytes())
            (folder / f"{name}.pem").write_bytes(b"".join(blob.bytes() for blob in leaf.cert_chain_pems))

    def config(self, example: str, name: str) -> Path:
        text = (EXAMPLES / example).read_text()
        text = text.replace("/etc/mavkf/reader.", f"/etc/mavkf/{name}.").replace("/etc/mavkf/", f"{self.folder}/")
        text = text.replace("0.0.0.0:7447", f"127.0.0.1:{self.port}").replace(
            "vehicle.example:7447", f"localhost:{self.port}"
        )
        path = self.folder / f"{name}.json5"
        path.write_text(text)
        return path


def test_the_right_certificate_reads_the_wrong_one_does_not_and_a_reader_cannot_reset(
    serve: Start, flight: Frames, tmp_path: Path
) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    keys = Keys(tmp_path, port)
    process = serve(
        "udpin:127.0.0.1:0", "--no-request", "--control", "--zenoh-config", keys.config("serve.json5", "serve")
    )
    with sender(process) as send:
        send(flight[:900])
        with subscribe("1-1", config_file=keys.config("reader.json5", "reader")) as poses:
            pose = poses.receive(20.0)
            assert pose is not None and pose.vehicle == "1-1"
            send(flight[900:950])
            assert poses.receive(20.0) is not None
        with pytest.raises(Exception, match="cannot be opened"):
            open_session(publishes=False, config_file=keys.config("reader.json5", "wrong"))
        with open_session(publishes=False, config_file=keys.config("reader.json5", "reader")) as reader:
            assert ask(reader, "reset") == []
        with open_session(publishes=False, config_file=keys.config("reader.json5", "operator")) as operator:
            assert ask(operator, "reset") == ['{"session":1}']
    assert process.interrupt() == 130
    assert sum("reset on request" in line for line in process.lines) == 2  # the event, and who asked
