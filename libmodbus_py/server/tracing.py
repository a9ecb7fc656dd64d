"""
Tells a trace of every ADU that a session receives and sends.

It stands around a session of whatever kind, sees the same bytes, and cuts them with framers of
its own: nothing inside knows of it, and without a trace it is not there.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import Iterator
from typing import Literal, NoReturn

from ..device.hooks import timed
from ..ports.endpoint import Endpoint
from ..ports.trace import OnTraced, Trace, Traced, is_traced
from ..protocol.errors import FrameError
from ..protocol.framing import (
    LINE_FEED,
    AsciiFramer,
    Frame,
    Framer,
    Framing,
    delimiter_after,
    make_framer,
)
from .limits import ServerStatistics
from .service import ENDS, Later, Link, MakeSession, Service

__all__ = ["TracedService", "Traces"]

logger: logging.Logger = logging.getLogger(__name__)


class Traces:
    """
    Who is told of ADUs. They come and go, in any thread.

    Args:
        first: called with a `Traced`; None for nobody.
    """

    def __init__(self, first: OnTraced | None) -> None:
        self._all: tuple[Harmless, ...] = () if first is None else (Harmless(first),)

    def __bool__(self) -> bool:
        return bool(self._all)

    def __call__(self, traced: Traced) -> None:
        for each in self._all:
            each(traced)

    @contextlib.contextmanager
    def with_another(self, callback: OnTraced) -> Iterator[None]:
        """Tell another one, too, while the block runs."""
        another = Harmless(callback)
        self._all += (another,)
        try:
            yield
        finally:
            self._all = tuple(each for each in self._all if each is not another)


class TracedService:
    """
    Another service, whose ADUs are told. See `Service`.

    Whether anybody wants to see them is asked when a connection is made.
    """

    def __init__(self, service: Service, traces: Traces) -> None:
        self._service = service
        self._traces = traces

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        make = self._service.sessions(endpoint, statistics, later)
        url, framing, traces = str(endpoint), endpoint.framing, self._traces

        def made(link: Link) -> TracedSession:
            return TracedSession(link, make, framing, Trace(url, traces, link.address))

        return lambda link: made(link) if is_traced(traces or None) else make(link)


class Harmless:
    """
    A callback that costs no client an answer, whatever it raises.

    One that fails is logged, and one that takes long, once each: a client must not be able to
    fill the log. SystemExit and KeyboardInterrupt leave the loop when this turn is over.
    """

    def __init__(self, callback: OnTraced) -> None:
        self._call = timed("trace", callback)
        self._has_failed = False

    def __call__(self, traced: Traced) -> None:
        try:
            self._call(traced)
        except ENDS as error:
            asyncio.get_running_loop().call_soon(_raise, error)
        except BaseException:
            if not self._has_failed:
                self._has_failed = True
                logger.exception("trace(%s) failed; this is said once", traced)


def _raise(error: BaseException) -> NoReturn:
    raise error


class TracedSession:
    """
    A session, and the link of the one inside.

    Args:
        link: of the connection.
        make: makes the session inside.
    """

    def __init__(self, link: Link, make: MakeSession, framing: Framing, trace: Trace) -> None:
        self.address: str = link.address
        self.role: str | None = link.role
        self._link = link
        self._received = Direction("received", framing, trace)
        self._sent = Direction("sent", framing, trace)
        self._inner = make(self)

    # --- the session of the connection --------------------------------------------------------

    @property
    def takes_requests(self) -> bool:
        return self._inner.takes_requests

    @property
    def is_unfinished(self) -> bool:
        return self._inner.is_unfinished

    @property
    def is_behind(self) -> bool:
        return self._inner.is_behind

    @property
    def is_waiting(self) -> bool:
        return self._inner.is_waiting

    @property
    def is_owing(self) -> bool:
        return self._inner.is_owing

    def receive(self, data: bytes) -> int:
        self._received.add(data)
        return self._inner.receive(data)

    def end(self) -> None:
        self._inner.end()

    def close(self) -> None:
        self._inner.close()
        self._received.end()
        self._sent.end()

    # --- for the session inside ---------------------------------------------------------------

    def write(self, data: bytes) -> None:
        # First: who has an answer finds it told.
        for answer in self._sent.add(data):
            self._follow_delimiter(answer.pdu)
        self._link.write(data)

    def follow(self) -> None:
        self._link.follow()

    def hang_up(self) -> bool:
        return self._link.hang_up()

    def _follow_delimiter(self, answer: bytes) -> None:
        for each in (self._received, self._sent):
            each.follow_delimiter(answer)


class Direction:
    """One direction of a connection, cut into ADUs; what is none is told as it is."""

    def __init__(
        self, direction: Literal["received", "sent"], framing: Framing, trace: Trace
    ) -> None:
        self._direction: Literal["received", "sent"] = direction
        self._framing: Framing = framing
        self._trace = trace
        self._delimiter = LINE_FEED
        self._framer = self._made()
        self._rest = b""  # the beginning of an ADU
        self._latest = 0.0

    def add(self, data: bytes) -> list[Frame]:
        """Tell of what these bytes complete; none say that the session was called again."""
        if not data:
            self._note_silence()
            return []
        self._latest = time.monotonic()
        # Of an answer whose end a fault took away nothing comes any more.
        if self._rest and self._direction == "sent" and self._is_whole(data):
            self.end()
        return self._take(data)

    def end(self) -> None:
        """Nothing more comes of what began."""
        if self._rest:
            self._trace.tell(self._direction, self._rest)
            self._rest = b""
            self._framer = self._made()

    def follow_delimiter(self, answer: bytes) -> None:
        """Take the delimiter of ASCII frames that counts after an answer."""
        self._delimiter = delimiter_after(answer, self._delimiter)
        self._set_delimiter(self._framer)

    def _made(self) -> Framer:
        framer = make_framer(self._framing, "server" if self._direction == "received" else "client")
        self._set_delimiter(framer)
        return framer

    def _set_delimiter(self, framer: Framer) -> None:
        if isinstance(framer, AsciiFramer):
            framer.delimiter = self._delimiter

    def _note_silence(self) -> None:
        quiet = self._framer.quiet
        if quiet and self._rest and time.monotonic() - self._latest >= quiet:
            self._tell(self._framer.scan_silence(), b"")

    def _is_whole(self, data: bytes) -> bool:
        framer = self._made()
        found = framer.scan(data)
        return not framer.pending and all(isinstance(each, Frame) for each in found)

    def _take(self, data: bytes) -> list[Frame]:
        if self._framer.in_step:
            return self._tell(self._framer.scan(data), data)
        self._trace.tell(self._direction, data)
        return []

    def _tell(self, found: list[Frame | FrameError], data: bytes) -> list[Frame]:
        frames = []
        for each in found:
            if isinstance(each, Frame):
                adu = self._framer.encode(each)
                self._trace.tell(self._direction, adu, each.unit, each.pdu[0])
                frames.append(each)
            else:
                self._trace.tell(self._direction, each.received)
        if self._direction == "sent" and not self._framer.in_step:
            self._framer = self._made()  # a fault has spoiled one answer, not the next
        pending = self._framer.pending
        self._rest = (self._rest + data)[-pending:] if pending else b""
        return frames
