"""
Sends the changes to open pages, at most ten times a second.
"""

from __future__ import annotations

import contextlib
import secrets
import threading
import time
from collections.abc import Hashable, Iterator, Mapping
from typing import Any

from ...ports.hosts import start_thread
from ...protocol.json_text import COMPACT_JSON
from ...protocol.logs import HarmlessLogger
from ...system import Flag
from .source import Changes, PageSource, PageView

__all__ = ["MOST_STREAMS", "FullError", "PageStream", "Streams"]

logger: HarmlessLogger = HarmlessLogger(__name__)

MOST_STREAMS = 16

# Seconds between two searches for changes. Each search is followed by a pause of at least nine
# times its duration, so that searches take at most a tenth of one processor.
PERIOD = 0.1
REST = 9

# The changes of each view, as JSON.
Texts = dict[Hashable, str]


class FullError(Exception):
    """`MOST_STREAMS` pages are open."""


class View:
    """The key of the view of a page. If a new object is set, the whole view is sent again."""

    def __init__(self, key: Hashable) -> None:
        self.key = key


class PageStream:
    """
    One open page. It has one message at a time; changes that it is too slow to take are dropped.

    Attributes:
        name: identifies the page in its requests.
        wake: a descriptor that is readable when there is a message.
        view: the view that it shows.
    """

    def __init__(self) -> None:
        self.name: str = secrets.token_hex(8)
        self._flag = Flag()
        self.wake: int = self._flag.descriptor
        self.view = View(None)
        # What the page has received: whether everything, of which structure, and for which view.
        self.is_behind = True
        self.shown: object = None
        self.told: View | None = None
        self._lock = threading.Lock()
        self._message = ""

    def offer(self, message: str) -> bool:
        """Offer a message; return False if the page has not taken the previous one."""
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
    All open pages of one address.

    Args:
        source: the things that the pages show.
    """

    def __init__(self, source: PageSource) -> None:
        self.source = source
        self._shown: object = None
        self._streams: dict[str, PageStream] = {}
        self._views: dict[Hashable, PageView] = {}
        self._changed = threading.Condition()
        self._is_wanted = True
        self._is_asked = False  # a page waits for its first message
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
            self._is_asked = True
            self._changed.notify_all()
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
        key = self.source.key(given)
        with self._changed:
            stream.view = View(key)
            self._is_asked = True
            self._changed.notify_all()

    # --- messages ----------------------------------------------------------------------

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
        source = self.source
        self._shown = source.structure()
        self._views = {key: view for key, view in self._views.items() if source.is_current(view)}
        with self._changed:
            streams = list(self._streams.values())
        common = _encoded(source.changes())
        views = [each.view for each in streams]
        changes = self._changes({each.key for each in views if each.key is not None})
        for stream, view in zip(streams, views, strict=True):
            self._tell(stream, view, common, changes)

    def _tell(self, stream: PageStream, view: View, common: str, changes: Texts) -> None:
        key = view.key
        if stream.is_behind or stream.shown is not self._shown:
            message = _message(_encoded(self._everything(stream)), self._all(key))
        elif stream.told is not view:
            message = _message(common, self._all(key))
        else:
            message = _message(common, changes.get(key, ""))
        stream.is_behind = bool(message) and not stream.offer(message)
        if not stream.is_behind:
            stream.shown, stream.told = self._shown, view

    def _changes(self, keys: set[Hashable]) -> Texts:
        self._views = {key: view for key in keys if (view := self._made(key)) is not None}
        found = ((key, view.look()) for key, view in self._views.items())
        return {key: self._text(key, changes) for key, changes in found if changes}

    def _made(self, key: Hashable) -> PageView | None:
        return self._views.get(key) or self.source.view(key)

    def _all(self, key: Hashable) -> str:
        view = self._views.get(key)
        return "" if view is None else self._text(key, view.all())

    def _text(self, key: Hashable, changes: Changes) -> str:
        return _encoded({**self.source.named(key), **changes})

    def _everything(self, stream: PageStream) -> Changes:
        found = {"all": True, "page": self.source.document, "stream": stream.name}
        more = self.source.described() if stream.shown is not self._shown else {}
        return {**found, **self.source.everything(), **more}


def _encoded(found: Changes) -> str:
    """Return a JSON object without its braces."""
    return COMPACT_JSON.encode(found)[1:-1]


def _message(*parts: str) -> str:
    inside = ",".join(part for part in parts if part)
    return f"data: {{{inside}}}\n\n" if inside else ""
