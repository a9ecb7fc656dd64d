"""listen(url): the transactions on a line, for a ``for`` loop or an ``async for`` loop."""

from __future__ import annotations

import asyncio
import contextlib
import os
import select
import threading
import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import Self

from ...ports.endpoint import Endpoint, parse_to_listen
from ...ports.port import REOPEN_AFTER, Outage
from ...ports.waiting import READ, Ready, Steps, WaitInterrupted, Waker, of_system, run, run_async
from ...protocol.errors import ModbusConnectionError
from ...protocol.logs import HarmlessLogger
from ...protocol.mistakes import named_parameters
from .capture import CaptureReader, CaptureWriter
from .packets import Packet
from .separator import LineFraming, Separator
from .sources import SerialSource, Tap, TimedBytes
from .streams import TcpStreams
from .transaction import Summary, TimedFrame, Transaction

logger: HarmlessLogger = HarmlessLogger(__name__)

Source = SerialSource | Tap

CAPTURES = (".pcapng", ".pcap")
"""The ends of the names of captures."""

# Seconds after which a quiet line is checked for requests without a response.
IDLE = 1.0


class Listener:
    """
    The traffic on a line, as an iterator of `Transaction`; made by `listen`.

    Use it in a ``with`` or ``async with`` block, which closes it. Iteration ends at the end of a
    capture, and when the listener is closed; a serial port that was unplugged is opened again when
    it is back. Iterate without delay, because a serial port buffers only 4096 bytes, and because
    bytes get the time at which they are read. With `between`, bytes are passed on in any case.

    Attributes:
        url: the URL, with the port that the system chose; or the path of the capture.
        summary: counts of the traffic so far.
        capture_error: the error after which the capture is not written any more; None while it is
            written. Listening goes on without the capture, and one warning is logged.

    Iteration raises CaptureError if the capture that is read is invalid, or ends inside a block;
    RuntimeError if another thread or task is iterating.
    """

    def __init__(
        self,
        url: str,
        framing: LineFraming,
        source: Source | CaptureReader,
        writer: CaptureWriter | None,
        clock: Clock,
        pause: float = 0.0,
    ) -> None:
        self.url: str = url
        self.summary: Summary = Summary()
        self.capture_error: OSError | None = None
        self._framing: LineFraming = framing
        self._pause = pause
        self._source = source
        self._writer = writer
        self._clock = clock
        self._separators: dict[int, Separator] = {}
        self._streams = TcpStreams(self._record)
        self._ready: deque[Transaction] = deque()
        self._lock = threading.RLock()  # reentrant, because a signal handler may close it
        self._is_busy = False
        self._is_closed = False
        self._waker = Waker()
        self._poller = select.epoll()
        self._poller.register(self._waker.descriptor, READ)
        if not isinstance(source, CaptureReader):
            self._poller.register(source.descriptor, READ)
        self._outage = Outage(logger, url)
        self._tick_after: float = IDLE

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the listener. May be called repeatedly, from any thread or a signal handler."""
        with self._lock:
            self._is_closed = True
            if self._is_busy:
                self._waker.wake()
            else:
                self._free()

    def __del__(self) -> None:
        with contextlib.suppress(Exception):  # __init__ may have failed
            self.close()

    def _free(self) -> None:
        self._end_all()  # what was heard is written, and `rest` returns it
        for part in (self._source, self._writer, self._poller, self._waker):
            if part is not None:
                part.close()

    @contextlib.contextmanager
    def _iterating(self) -> Iterator[None]:
        """Keep everything open while a thread or task waits, and others from waiting."""
        with self._lock:
            if self._is_busy:
                raise RuntimeError("another thread or task is listening already")
            self._is_busy = True
        try:
            yield
        finally:
            with self._lock:
                self._is_busy = False
                if self._is_closed:
                    self._free()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Transaction:
        transaction = None
        with self._iterating(), contextlib.suppress(WaitInterrupted):
            transaction = run(self._next(), self._waker)
        if transaction is None:
            raise StopIteration
        return transaction

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Transaction:
        with self._iterating():
            # There is no other wait in a flood or a capture, but other tasks must run, too.
            await asyncio.sleep(0)
            transaction = await run_async(self._next())
        if transaction is None:
            raise StopAsyncIteration
        return transaction

    def rest(self) -> list[Transaction]:
        """Return the transactions that were not iterated; pending requests count as unanswered."""
        self._end_all()
        rest, self._ready = list(self._ready), deque()
        return rest

    def _next(self) -> Steps[Transaction | None]:
        while not self._ready and not self._is_closed:
            if isinstance(self._source, CaptureReader):
                if not self._read_on(self._source):
                    break
            elif self._outage.is_on:
                yield Ready(self._poller.fileno(), READ, time.monotonic() + REOPEN_AFTER)
                if not self._is_closed and self._outage.try_to_end(self._source.open):
                    self._poller.register(self._source.descriptor, READ)
            else:
                yield from self._hearing(self._source)
        return self._ready.popleft() if self._ready and not self._is_closed else None

    def _hearing(self, source: Source) -> Steps[None]:
        deadline = time.monotonic() + self._tick_after
        is_ready = yield Ready(self._poller.fileno(), READ, deadline)
        if self._is_closed:
            return
        if not is_ready:
            self._tick_after = IDLE
            now = self._clock()
            for separator in self._separators.values():
                self._add(separator.tick(now))
            return
        try:
            pieces = source.receive()
        except ModbusConnectionError as error:
            self._outage.begin(error)
            self._poller.unregister(source.descriptor)
            source.close()
            self._end_all()
            return
        for piece in pieces:
            self._feed(piece)

    def _feed(self, piece: TimedBytes) -> None:
        if piece.data:
            separator = self._separator(piece.link)
            self._tick_after = min(separator.quiet, IDLE)
            self._add(separator.feed(piece.data, piece.at, piece.sender))
        elif piece.link in self._separators:
            self._add(self._separators.pop(piece.link).end())

    def _read_on(self, reader: CaptureReader) -> bool:
        """Read a frame; at the end of the capture, return True if there are transactions left."""
        for event in reader.events:
            if isinstance(event, Packet):
                self._add(self._streams.take(event))
            else:
                self._add(self._separator(event[0]).take(event[1]))
            return True
        self._end_all()
        return bool(self._ready)

    def _separator(self, link: int) -> Separator:
        if link not in self._separators:
            on_heard = partial(self._record, link)
            self._separators[link] = Separator(self._framing, on_heard, self._pause)
        return self._separators[link]

    def _record(self, link: int, event: TimedFrame) -> None:
        """Write to the capture; if that fails, end the capture, but continue to listen."""
        if self._writer is None or self.capture_error is not None:
            return
        try:
            self._writer.write(event, link=link)
        except OSError as error:
            self.capture_error = of_system(error)
            logger.warning("%s: %s; the capture ends here", error.filename, error.strerror)

    def _end_all(self) -> None:
        separators, self._separators = self._separators, {}
        for separator in separators.values():
            self._add(separator.end())
        self._add(self._streams.end())

    def _add(self, transactions: list[Transaction]) -> None:
        for transaction in transactions:
            self.summary.add_transaction(transaction)
        self._ready += transactions


class Clock:
    """Seconds since the epoch that never go back; set again after a minute without a call."""

    def __init__(self) -> None:
        self._offset = time.time() - time.monotonic()
        self._last = time.monotonic()

    def __call__(self) -> float:
        now = time.monotonic()
        if now - self._last > 60.0:
            self._offset = max(self._offset, time.time() - now)
        self._last = now
        return now + self._offset


@named_parameters
def listen(
    url: str, *, between: str | None = None, capture: str | os.PathLike[str] | None = None
) -> Listener:
    """
    Listen to the traffic between other devices on a line.

    Args:
        url: a serial port (rtu, ascii), which is opened for reading only; or, with `between`, an
            address at which clients connect (rtu+tcp, ascii+tcp); or the path of a capture,
            ending in .pcapng or .pcap: one of this package, or one of a network with Modbus/TCP,
            as of tcpdump or Wireshark.
        between: the URL of the device for these clients, with the same scheme; bytes are passed
            on unchanged in both directions.
        capture: the path of a new pcapng file, or of a pipe, to which frames are written. Wireshark
            can decode it, and it can be the `url` of another call.

    Returns:
        An open iterator, for a ``for`` loop or an ``async for`` loop.

    Raises:
        TypeError, ValueError: a URL is wrong, it is not possible to listen to it, or the file of
            `capture` exists.
        ModbusConnectionError: the port cannot be opened, with errno.
        OSError: a capture cannot be opened.
        CaptureError: `url` is not a valid capture.
    """
    clock = Clock()
    framing: LineFraming = "rtu"
    pause = 0.0
    with contextlib.ExitStack() as stack:
        source: Source | CaptureReader
        if isinstance(url, str) and url.endswith(CAPTURES) and "://" not in url:
            if between is not None:
                raise ValueError("between cannot be given with a capture")
            name, source = url, CaptureReader(url)
        else:
            if isinstance(url, str) and os.path.isfile(url):
                raise ValueError(f"{url}: the name of a capture must end with .pcapng or .pcap")
            endpoint = parse_to_listen(url)
            source = _source(endpoint, None if between is None else parse_to_listen(between), clock)
            name = str(source.endpoint if isinstance(source, Tap) else endpoint)
            framing, pause = "ascii" if endpoint.framing == "ascii" else "rtu", endpoint.pause
        stack.callback(source.close)
        writer = None if capture is None else CaptureWriter(capture, name)
        if writer is not None:
            stack.callback(writer.close)
        try:
            listener = Listener(name, framing, source, writer, clock, pause)
        except OSError as error:  # no descriptor is left
            raise ModbusConnectionError(
                f"cannot listen to {name}: {error.strerror}", errno=error.errno
            ) from error
        stack.pop_all()
        return listener


IN_TLS = (
    "listening cannot see into TLS; a gateway, with a certificate for each side, decodes and shows"
    " the requests that it forwards"
)


def _source(endpoint: Endpoint, target: Endpoint | None, clock: Clock) -> Source:
    """Open the source; raise ValueError if it is not possible to listen to it."""
    for place in filter(None, (endpoint, target)):
        if place.is_secure:
            raise ValueError(f"{place}: {IN_TLS}")
    if endpoint.is_serial:
        if target is not None:
            raise ValueError("between needs rtu+tcp or ascii+tcp; a serial port is only read")
        port = SerialSource(endpoint, clock)
        port.open()
        return port
    if endpoint.is_datagram or endpoint.has_transactions:
        raise ValueError(
            f"{endpoint}: the scheme must be rtu, ascii, or rtu+tcp or ascii+tcp with between"
        )
    if target is None:
        raise ValueError(f"{endpoint}: between is missing: the device to connect to")
    if target.scheme != endpoint.scheme:
        raise ValueError(
            f"{target}: the scheme must be {endpoint.scheme}, because bytes are passed on unchanged"
        )
    if not target.port:
        raise ValueError(f"{target}: the port of the device must be in 1..65535")
    return Tap(endpoint, target, clock)
