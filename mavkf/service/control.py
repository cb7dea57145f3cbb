"""Acting on a running service over zenoh; it exists only where it was asked for.

    mavkf/<vehicle>/@ctl/reset     a query ends the session of the estimate and begins another with nothing known
    mavkf/<vehicle>/@ctl/config    a query gives the settings in use; with lines of `section.key=value` it changes them and resets

The answer is JSON: {"session": the number of the session that begins} or the settings, or an error in a sentence. Both are done by the
worker, between two batches of frames, and what comes after them is recorded apart: each recording replays by itself.
"""

from collections.abc import Callable
from queue import Empty, Full, Queue

import msgspec
import zenoh
from zenoh.handlers import Callback

from mavkf.config import with_settings
from mavkf.errors import MavkfError, UsageError
from mavkf.service.fleet import Fleet

WAITING = 16
KEYS = "mavkf/*/@ctl/*"


class Control:
    """Takes queries in zenoh's threads, and acts on the fleet where `work` is called."""

    def __init__(self, session: zenoh.Session, fleet: Fleet, say: Callable[[str], None]) -> None:
        """Declare the queryable; say: told what was done."""
        self._fleet, self._say = fleet, say
        self._queries: Queue[zenoh.Query] = Queue(WAITING)
        self._queryable = session.declare_queryable(KEYS, Callback(self._take, indirect=False))

    def _take(self, query: zenoh.Query) -> None:
        try:
            self._queries.put_nowait(query)
        except Full:
            with query:
                query.reply_err(b"too many requests wait already: ask again later")

    def work(self) -> None:
        """Do what was asked for, and answer."""
        while True:
            try:
                query = self._queries.get_nowait()
            except Empty:
                return
            with query:
                self._answer(query)

    def _answer(self, query: zenoh.Query) -> None:
        parts = str(query.key_expr).split("/")
        text = query.payload.to_bytes().decode(errors="replace") if query.payload is not None else ""
        try:
            if len(parts) != 4 or "*" in "".join(parts):
                raise UsageError("name one vehicle and one action, as in mavkf/1-1/@ctl/reset")
            answer = self._act(parts[1], parts[3], text)
        except MavkfError as error:
            query.reply_err(str(error).encode())
            return
        query.reply(query.key_expr, msgspec.json.encode(answer), encoding="application/json")

    def _act(self, name: str, action: str, text: str) -> object:
        vehicle = next((one for one in self._fleet.vehicles.values() if one.name == name), None)
        if vehicle is None:
            names = ", ".join(sorted(one.name for one in self._fleet.vehicles.values())) or "none"
            raise UsageError(f"there is no vehicle {name}: {names} can be heard")
        if action == "config" and not text.strip():
            return vehicle.stream.config
        if action not in ("reset", "config"):
            raise UsageError(f"there is no action {action}: only reset and config")
        lines = [line.strip() for line in text.splitlines() if line.strip()] if action == "config" else []
        self._fleet.reset(vehicle, with_settings(vehicle.stream.config, lines))
        self._say(f"vehicle {name}: {action} on request{': ' if lines else ''}{', '.join(lines)}")
        return {"session": max(vehicle.stream.first_session, 0)}

    def close(self) -> None:
        """Withdraw the queryable."""
        self._queryable.undeclare()  # type: ignore[no-untyped-call]
