"""
Keeps open pages up to date: each is sent the rows that it lacks, at most ten times a second.

A page shows tables of rows: ``{table: {key: row}}``, in JSON. For each open page, its thread keeps
the tables that it has sent, compares them with those that the page shows now, and sends the
difference, which is the only kind of message::

    {"log": {"17": [...], "3": null}, "1/coils": null}

A row is new or has changed; null in its place means that the row, or the whole table, is gone. A
new page has no tables, so its first message contains everything. A page that reads slowly gets the
next message afterwards, with all that has changed meanwhile.
"""

from __future__ import annotations

import contextlib
import secrets
import select
import socket
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any, Protocol

from ...protocol.json_text import COMPACT_JSON
from ...protocol.logs import HarmlessLogger
from ...system import Flag

logger: HarmlessLogger = HarmlessLogger(__name__)

# Pages that may be open at once: each takes a thread.
MOST_STREAMS = 16

# Seconds between two comparisons. Each is followed by a pause of at least nine times its duration
# and as many times as pages are open, so that all take at most a tenth of one processor.
PERIOD = 0.1
REST = 9

# Seconds after which an idle stream sends a comment, which shows whether the browser is there.
HEARTBEAT = 5.0

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
    """The content of all open pages of one address; several threads may call its actions."""

    script: str
    actions: Mapping[str, Action]
    downloads: Mapping[str, Download]

    def view(self, query: Mapping[str, Any]) -> Hashable:
        """Return the view that a request names; raise as an `Action` if there is no such view."""
        ...

    def common(self) -> Tables: ...

    def tables_of(self, view: Any) -> Tables: ...


def difference(before: Tables, after: Tables) -> dict[str, Any]:
    """Return the rows that have changed; None in place of rows and tables that are gone."""
    changes: dict[str, Any] = {}
    for table, rows in after.items():
        old = before.get(table)
        if old is None:
            changes[table] = rows
        elif old != rows:
            updates = {key: row for key, row in rows.items() if key not in old or old[key] != row}
            changes[table] = updates | dict.fromkeys(old.keys() - rows.keys())
    return changes | dict.fromkeys(before.keys() - after.keys())


class HttpRefusal(Exception):
    """A request that is answered with this status of HTTP and text."""

    def __init__(self, status: int, text: str) -> None:
        super().__init__(text)
        self.status = status


class _OpenPage:
    """An open page, the view that it shows, if any, and a flag that is set for another view."""

    def __init__(self) -> None:
        self.head = {"stream": secrets.token_hex(8), "now": time.time()}
        self.view: Hashable = None
        self.flag = Flag()


class Streams:
    """All open pages of one address."""

    def __init__(self, source: PageSource) -> None:
        self.source = source
        self._pages: dict[Any, _OpenPage] = {}
        self._lock = threading.Lock()
        self._has_failed = False

    @contextlib.contextmanager
    def open_stream(self, connection: socket.socket) -> Iterator[Iterator[str]]:
        """Return the messages to one more page, which end when the browser closes it."""
        with self._lock:
            if len(self._pages) >= MOST_STREAMS:
                raise HttpRefusal(503, f"{MOST_STREAMS} pages are open, which is the maximum")
            page = _OpenPage()
            self._pages[page.head["stream"]] = page
        try:
            yield self._messages(page, connection)
        finally:
            with self._lock:
                del self._pages[page.head["stream"]]
                page.flag.close()

    def look_at(self, query: Mapping[str, Any]) -> None:
        """Set the view of a page; raise as an `Action` if there is no such page or view."""
        view = self.source.view(query)
        with self._lock:
            name = query["stream"]
            page = self._pages.get(name) if isinstance(name, str) else None
            if page is None:
                raise ValueError("this page is no longer open")
            page.view = view
            page.flag.set()

    def _messages(self, page: _OpenPage, connection: socket.socket) -> Iterator[str]:
        poll = select.poll()
        poll.register(connection, select.POLLIN | select.POLLHUP)
        poll.register(page.flag.descriptor, select.POLLIN)
        former: Tables = {}
        spoke = time.monotonic()
        while True:
            began = time.thread_time()
            tables = self._tables(page, former)
            if changes := difference(former, tables):
                former, spoke = tables, time.monotonic()
                yield f"data: {COMPACT_JSON.encode(changes)}\n\n"
            elif time.monotonic() - spoke > HEARTBEAT:
                spoke = time.monotonic()
                yield ": \n\n"
            took = time.thread_time() - began
            ready = dict(poll.poll(1000 * max(PERIOD, REST * took * len(self._pages))))
            if connection.fileno() in ready:  # the browser has closed the connection
                return
            page.flag.clear()

    def _tables(self, page: _OpenPage, former: Tables) -> Tables:
        """Return what the page shows now; what was sent if that cannot be found out."""
        try:
            with self._lock:
                common = self.source.common()
                tables_of = {} if page.view is None else self.source.tables_of(page.view)
        except Exception:
            if not self._has_failed:  # once, not ten times a second
                self._has_failed = True
                logger.exception("the page cannot be updated; this is logged once")
            return former
        return {"page": {"script": self.source.script, **page.head}, **common, **tables_of}
