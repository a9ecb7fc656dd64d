"""
Keeps open pages up to date: each is sent the rows that it lacks, at most ten times a second.

A page shows tables of rows: ``{table: {key: row}}``, in JSON. For each open page, the server keeps
the tables that it has sent, compares them with those that the page shows now, and sends the
difference, which is the only kind of message::

    {"log": {"17": [...], "3": null}, "1/coils": null}

A row is new or has changed; null in its place means that the row, or the whole table, is gone. A
new page has no tables, so its first message contains everything. A page that has not read its last
message gets the next one afterwards, with all that has changed meanwhile.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, Protocol

from ...ports.hosts import start_thread
from ...protocol.json_text import COMPACT_JSON
from ...protocol.logs import HarmlessLogger
from ...system import Flag

__all__ = [
    "Action",
    "Download",
    "FullError",
    "PageSource",
    "PageStream",
    "Streams",
    "Tables",
    "difference",
]

logger: HarmlessLogger = HarmlessLogger(__name__)

# Pages that may be open at once: each takes a thread.
MOST_STREAMS = 16

# Seconds between two comparisons. Each is followed by a pause of at least nine times its duration,
# so that comparisons take at most a tenth of one processor.
PERIOD = 0.1
REST = 9

Tables = dict[str, Mapping[Any, Any]]
"""Table -> key -> row, for JSON. Rows that were returned are not changed afterwards."""

Action = Callable[[Mapping[str, Any]], object]
"""
Takes the JSON object of a request, and returns the JSON object of the response. Raises TypeError,
ValueError or KeyError if the object is wrong or lacks a key.
"""

Download = Callable[[Mapping[str, str]], str]
"""Takes the fields of a query, and returns CSV."""


class PageSource(Protocol):
    """
    The things that all open pages of one address show; a thread of the page calls the methods.

    Attributes:
        script: the script of the page that shows these tables.
        actions: the functions that answer requests of pages, by path; called in any thread.
        downloads: the functions that make files to download, by path; called in any thread.
    """

    script: str
    actions: Mapping[str, Action]
    downloads: Mapping[str, Download]

    def common(self) -> Tables:
        """Return the tables that all pages show."""
        ...

    def view(self, given: Mapping[str, Any]) -> Hashable:
        """
        Return the view that a page requests.

        Raises:
            TypeError, ValueError, KeyError: there is no such view.
        """
        ...

    def viewed(self, view: Any) -> Tables:
        """Return the tables of a view; none if it does not exist any more."""
        ...


def difference(before: Tables, after: Tables) -> dict[str, Any]:
    """Return the rows that have changed; None in place of rows and tables that are gone."""
    found: dict[str, Any] = {}
    for table, rows in after.items():
        old = before.get(table)
        if old is None:
            found[table] = rows
        elif old != rows:
            changed = {key: row for key, row in rows.items() if key not in old or old[key] != row}
            found[table] = changed | dict.fromkeys(old.keys() - rows.keys())
    return found | dict.fromkeys(before.keys() - after.keys())


class FullError(Exception):
    """`MOST_STREAMS` pages are open."""


class PageStream:
    """
    One open page.

    Attributes:
        name: identifies the page in its requests.
        wake: a descriptor that is readable when there is a message.
        view: the view that the page shows; None before its first request.
    """

    def __init__(self) -> None:
        self.name: str = secrets.token_hex(8)
        self.opened: float = time.time()
        self.view: Hashable = None
        self._flag = Flag()
        self.wake: int = self._flag.descriptor
        self._sent: Tables = {}
        self._lock = threading.Lock()
        self._message = ""

    def bring(self, tables: Tables) -> None:
        """Send what differs from the tables that were sent, once the last message was taken."""
        with self._lock:
            if self._message or self.wake < 0:
                return
            if changed := difference(self._sent, tables):
                self._message = f"data: {COMPACT_JSON.encode(changed)}\n\n"
                self._sent = tables
                self._flag.set()

    def take(self) -> str:
        """Return the message that waits."""
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
    All open pages of one address.

    Args:
        source: the things that the pages show.
    """

    def __init__(self, source: PageSource) -> None:
        self.source = source
        self._streams: dict[str, PageStream] = {}
        self._changed = threading.Condition()
        self._is_wanted = True
        self._is_asked = False  # a page waits for its first message, or for another view
        self._has_failed = False
        self._thread = threading.Thread(target=self._run, name="page", daemon=True)

    # --- open pages ------------------------------------------------------------------

    @contextlib.contextmanager
    def sending(self) -> Iterator[None]:
        """
        Send changes to open pages, from a thread, while the ``with`` block runs.

        Raises:
            OSError: the system cannot start another thread.
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
            FullError: `MOST_STREAMS` pages are open already.
        """
        with self._changed:
            if len(self._streams) >= MOST_STREAMS:
                raise FullError(f"{MOST_STREAMS} pages are open, which is the maximum")
            stream = PageStream()
            self._streams[stream.name] = stream
            self._ask()
        try:
            yield stream
        finally:
            with self._changed:
                del self._streams[stream.name]
            stream.end()

    def look_at(self, given: Mapping[str, Any]) -> None:
        """
        Set the view of a page.

        Raises:
            TypeError, ValueError, KeyError: there is no such page or view.
        """
        name = given["stream"]
        stream = self._streams.get(name) if isinstance(name, str) else None
        if stream is None:
            raise ValueError("this page is no longer open")
        view = self.source.view(given)
        with self._changed:
            stream.view = view
            self._ask()

    def _ask(self) -> None:
        self._is_asked = True
        self._changed.notify_all()

    # --- messages ----------------------------------------------------------------------

    def _run(self) -> None:
        while self._wait():
            before = time.thread_time()
            try:
                self._send()
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

    def _send(self) -> None:
        with self._changed:
            looking = [(each, each.view) for each in self._streams.values()]
        common = self.source.common()
        viewed = {
            view: self.source.viewed(view)
            for view in {view for _, view in looking if view is not None}
        }
        for stream, view in looking:
            own = {"script": self.source.script, "stream": stream.name, "now": stream.opened}
            stream.bring({"page": own, **common, **viewed.get(view, {})})
