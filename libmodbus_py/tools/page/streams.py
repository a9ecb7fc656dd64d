"""
The changes that open pages are sent, ten times a second at most.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from ...ports.names import start_thread
from ...protocol.json_text import COMPACT_JSON
from ...protocol.logs import HarmlessLogger
from ...protocol.tables import TABLES
from ...protocol.values import ORDERS, TYPES
from ...server.faults.fault import KINDS, OPTIONAL
from ...server.server import Server
from ...system import Flag
from .fault_list import FaultList
from .log import Log
from .shown import ShownServer, ShownUnit, shown_of
from .views import CellsView, PageView, PointsView

__all__ = ["MOST_STREAMS", "FullError", "PageStream", "Streams"]

logger: HarmlessLogger = HarmlessLogger(__name__)

MOST_STREAMS = 16

# Seconds between two looks for changes. After each, the next waits for at least nine times as long
# as it took, so that all together take at most a tenth of one processor.
PERIOD = 0.1
REST = 9

# The choices of the page; each kind of fault has the setting that it needs, if any.
WORDS: dict[str, Any] = {
    "types": list(TYPES),
    "orders": list(ORDERS),
    "kinds": {
        kind: setting or next((each for each in OPTIONAL.get(kind, ()) if each == "length"), None)
        for kind, setting in KINDS.items()
    },
}

# The view of a page: unit, table or "points", the first of them, and the end.
Key = tuple["int | None", str, int, int]


# The changes of each view, as JSON.
Texts = dict["Key | None", str]


class FullError(Exception):
    """`MOST_STREAMS` pages are open."""


class PageStream:
    """
    One open page. It has one message at a time; changes that it is too slow to take are dropped.

    Attributes:
        name: identifies the page in its requests.
        wake: a descriptor that is readable when there is a message.
        key: its view.
    """

    def __init__(self) -> None:
        self.name: str = secrets.token_hex(8)
        self._flag = Flag()
        self.wake: int = self._flag.descriptor
        self.key: Key | None = None
        # What the page was sent: whether everything, for which devices, and for which view.
        self.is_behind = True
        self.shown: ShownServer | None = None
        self.told: Key | None = None
        self._lock = threading.Lock()
        self._message = ""

    def offer(self, message: str) -> bool:
        """Offer a message; return False if the page has not taken the last one."""
        with self._lock:
            if self._message or self.wake < 0:
                return False
            self._message = message
            self._flag.set()
        return True

    def take(self) -> str:
        with self._lock:
            message, self._message = self._message, ""
            self._flag.clear()
        return message

    def end(self) -> None:
        with self._lock:
            self.wake = -1
            self._flag.close()


class Streams:
    """
    All open pages of a server.

    Attributes:
        log, faults: shown on all pages.
    """

    def __init__(self, server: Server) -> None:
        self._server = server
        self._shown = shown_of(server)
        self.log: Log = Log(lambda: self._shown)
        self.faults: FaultList = FaultList(server.fault_switch)
        self._streams: dict[str, PageStream] = {}
        self._views: dict[Key, PageView] = {}
        self._counters: dict[str, int] = {}
        self._told = (0, 0, -1)  # the last transaction, write and version of the faults
        self._changed = threading.Condition()
        self._is_wanted = True
        self._is_asked = False  # a page waits for its first message
        self._has_failed = False
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    @property
    def shown(self) -> ShownServer:
        """The devices that the server has now."""
        if self._server.devices is not self._shown.given:
            self._shown = shown_of(self._server)
        return self._shown

    def unit(self, number: object) -> ShownUnit:
        """
        Return the unit of a number.

        Raises:
            ValueError: there is no such unit.
        """
        found = self.shown.units.get(number) if isinstance(number, int | None) else None
        if found is None:
            raise ValueError(f"there is no unit {number}")
        return found

    # --- pages that come and go ------------------------------------------------------------------

    @contextlib.contextmanager
    def sending(self) -> Iterator[None]:
        """
        Send open pages what has changed, from a thread, while the ``with`` block runs.

        Raises:
            OSError: there are too many threads.
        """
        start_thread(self._thread)
        try:
            yield
        finally:
            with self._changed:
                self._is_wanted = False
                self._changed.notify_all()
            self._thread.join(5)

    @contextlib.contextmanager
    def opened(self) -> Iterator[PageStream]:
        """
        Open one more page while the block runs.

        Raises:
            FullError: there are too many.
        """
        with self._changed:
            if len(self._streams) >= MOST_STREAMS:
                raise FullError(f"{MOST_STREAMS} pages are open, as many as may be")
            stream = PageStream()
            self._streams[stream.name] = stream
            self._is_asked = True
            self._changed.notify_all()
        try:
            yield stream
        finally:
            with self._changed:
                del self._streams[stream.name]
            stream.end()

    def look_at(self, name: object, number: object, what: object, first: int, stop: int) -> None:
        """
        Set the view of a page: cells of a table, or "points".

        Raises:
            ValueError: there is no such page, unit or table.
        """
        stream = self._streams.get(name) if isinstance(name, str) else None
        if stream is None:
            raise ValueError("there is no such page any more")
        unit = self.unit(number)
        if not isinstance(what, str) or (what != "points" and what not in TABLES):
            raise ValueError("what must be points or a table")
        with self._changed:
            stream.key = (unit.number, what, max(first, 0), max(stop, 0))
            self._is_asked = True
            self._changed.notify_all()

    # --- what they are sent ----------------------------------------------------------------------

    def _run(self) -> None:
        while self._wait():
            before = time.thread_time()
            try:
                self._look()
            except Exception:
                if not self._has_failed:  # once, not ten times a second
                    self._has_failed = True
                    logger.exception("the page cannot be updated; this is logged once")
            took = time.thread_time() - before
            with self._changed:
                self._changed.wait_for(lambda: not self._is_wanted, REST * took)
                rest = PERIOD - took - REST * took
                self._changed.wait_for(lambda: self._is_asked or not self._is_wanted, rest)
                self._is_asked = False

    def _wait(self) -> bool:
        """Wait until a page is open; return False at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._streams or not self._is_wanted)
            return self._is_wanted

    def _look(self) -> None:
        if self._shown is not self.shown or any(
            view.unit is not self._shown.units.get(view.unit.number)
            for view in self._views.values()
        ):
            self._views.clear()
        with self._changed:
            streams = list(self._streams.values())
        common = _encoded(self._common_changes())
        keys = [each.key for each in streams]
        changes = self._changes({key for key in keys if key is not None})
        for stream, key in zip(streams, keys, strict=True):
            self._tell(stream, key, common, changes)

    def _tell(self, stream: PageStream, key: Key | None, common: str, changes: Texts) -> None:
        if stream.is_behind or stream.shown is not self._shown:
            message = _message(_encoded(self._everything(stream)), self._all(key))
        elif stream.told != key:
            message = _message(common, self._all(key))
        else:
            message = _message(common, changes.get(key, ""))
        stream.is_behind = bool(message) and not stream.offer(message)
        if not stream.is_behind:
            stream.shown, stream.told = self._shown, key

    def _changes(self, keys: set[Key]) -> Texts:
        self._views = {key: view for key in keys if (view := self._made(key)) is not None}
        found = ((key, view.look()) for key, view in self._views.items())
        return {key: _encoded(_named(key, changes)) for key, changes in found if changes}

    def _made(self, key: Key) -> PageView | None:
        if key in self._views:
            return self._views[key]
        number, what, first, stop = key
        unit = self._shown.units.get(number)
        if unit is None:  # the unit is gone
            return None
        if what == "points":
            return PointsView(unit, first, stop)
        return CellsView(unit, what, first, stop)

    def _all(self, key: Key | None) -> str:
        view = None if key is None else self._views.get(key)
        return "" if view is None or key is None else _encoded(_named(key, view.all()))

    def _common_changes(self) -> dict[str, Any]:
        passed, written, version = self._told
        found: dict[str, Any] = {
            "log": self.log.rows(passed),
            "written": self.log.written(written),
        }
        counters: dict[str, int] = asdict(self._server.statistics)
        found["counters"] = {
            name: value for name, value in counters.items() if value != self._counters.get(name)
        }
        self._counters = counters
        if version != (latest := self.faults.version):
            version, found["faults"] = latest, self.faults.as_json()
        if found["log"]:
            passed = found["log"][-1].number
        if found["written"]:
            written = found["written"][-1].number
        self._told = passed, written, version
        return {name: value for name, value in found.items() if value or name == "faults"}

    def _everything(self, stream: PageStream) -> dict[str, Any]:
        found: dict[str, Any] = {
            "all": True,
            "stream": stream.name,
            "log": self.log.rows(),
            "written": self.log.written(),
            "counters": self._counters,
            "faults": self.faults.as_json(),
            "words": WORDS,
        }
        if stream.shown is not self._shown:
            found["units"] = self._shown.as_json()
        return found


def _named(key: Key, changes: dict[str, Any]) -> dict[str, Any]:
    return {"unit": key[0], "what": key[1], **changes}


def _encoded(found: dict[str, Any]) -> str:
    """Return a JSON object without its braces."""
    return COMPACT_JSON.encode(found)[1:-1]


def _message(*parts: str) -> str:
    inside = ",".join(part for part in parts if part)
    return f"data: {{{inside}}}\n\n" if inside else ""
