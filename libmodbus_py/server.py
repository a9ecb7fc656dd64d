"""
The server: many clients, many units, many endpoints, in one asyncio loop.

Bytes go through a framer of their connection to the device of their unit, and
the answers back in order of arrival. Nobody waits for anybody: a client that
does not read its answers is not read either.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import threading
import time
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

from . import url
from .device import Device
from .errors import (
    FrameError,
    ModbusConnectionError,
    ModbusTimeoutError,
)
from .faults import Delivery, Fault, Faults, pieces
from .framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer
from .serial_link import SerialLink
from .units import SerialUnits, TcpUnits, Units

__all__ = ["Running", "Server"]

logger = logging.getLogger(__name__)

FRAMERS: dict[str, Callable[[], Framer]] = {
    "tcp": TcpFramer,
    "rtu": partial(RtuFramer, role="server"),
    "ascii": AsciiFramer,
}

# How much is read at once: the others wait while that many requests are answered.
READ_SIZE = 4096

STOP_WITHIN = 0.5

# How long an unplugged serial port is left alone before the next attempt.
REOPEN_AFTER = 1.0


@dataclass(frozen=True)
class Running:
    """
    A server that serves.

    Attributes:
        urls: its endpoints, in the order given, with the ports they got.
    """

    urls: list[str]


class Server:
    """
    Serves devices to any number of clients.

    On TCP a unit without a device is answered with exception 11; on serial lines
    (and such lines over TCP) it is silence, and unit 0 is a broadcast: writes go to
    every device, nobody answers.

    Args:
        devices: ``{unit 0..255: device}``, or one device that answers every unit.
        faults: ``{unit 0..255: faults}``, what goes wrong with the answers of a unit;
            None is every unit.

    Raises:
        TypeError, ValueError: `devices` or `faults` is something else.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
    ) -> None:
        self._units = Units(devices, Faults({} if faults is None else faults))

    @contextlib.asynccontextmanager
    async def serving(self, *urls: str) -> AsyncIterator[Running]:
        """
        Serve while the ``async with`` block runs.

        Args:
            urls: where to listen (`libmodbus_py.url`): tcp, rtu+tcp, ascii+tcp
                with port 0 for a free one; rtu, ascii for serial ports.

        Raises:
            TypeError, ValueError: a URL is wrong, or there is none.
            ModbusConnectionError: an endpoint cannot be opened, with errno.
        """
        endpoints = [url.parse(address) for address in urls]
        if not endpoints:
            raise ValueError("urls must name at least one endpoint")
        async with contextlib.AsyncExitStack() as stack:
            opened = []
            for endpoint in endpoints:
                serve = _serve_tcp if endpoint.is_tcp else _serve_serial
                opened.append(await stack.enter_async_context(serve(endpoint, self._units)))
            yield Running([str(endpoint) for endpoint in opened])

    @contextlib.contextmanager
    def background(self, *urls: str) -> Iterator[Running]:
        """
        Serve in a thread of its own while the ``with`` block runs.

        Arguments and exceptions as for `serving`.
        """
        started: Future[tuple[Running, Callable[[], object]]] = Future()

        async def serve() -> None:
            stopped = asyncio.Event()
            loop = asyncio.get_running_loop()
            async with self.serving(*urls) as running:
                started.set_result((running, partial(loop.call_soon_threadsafe, stopped.set)))
                await stopped.wait()

        def run() -> None:
            try:
                asyncio.run(serve())
            except BaseException as error:
                if started.done():
                    raise
                started.set_exception(error)

        thread = threading.Thread(target=run, name="modbus server", daemon=True)
        thread.start()
        running, stop = started.result()
        try:
            yield running
        finally:
            stop()
            thread.join()


class _Session:
    """One connection or one port: bytes in, answers out."""

    def __init__(
        self,
        units: TcpUnits | SerialUnits,
        framing: str,
        peer: str,
        write: Callable[[bytes], None],
        follow: Callable[[], None] = lambda: None,
    ) -> None:
        self._units = units
        self._framer = FRAMERS[framing]()
        self._peer = peer
        self._write = write
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        # Only with faults do answers leave at other times than they are found.
        self._delivery = Delivery(write, follow) if units.faults else None
        self._follow_delimiter()

    @property
    def is_waiting(self) -> bool:
        """Whether a fault keeps an answer back; the next request can wait, too."""
        return self._delivery is not None and self._delivery.is_waiting

    def receive(self, data: bytes) -> None:
        """
        Take received bytes, write the answers.

        Raises:
            FrameError: the stream must be closed; what could be answered was.
        """
        self._answer(self._framer.scan(data))
        if not self._framer.in_step:
            raise FrameError("stream out of step")
        self._stop_timer()
        if self._framer.quiet and self._framer.pending:
            self._timer = self._loop.call_later(self._framer.quiet, self._silence)

    def close(self) -> None:
        self._stop_timer()
        if self._delivery is not None:
            self._delivery.close()

    def _stop_timer(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _silence(self) -> None:
        self._answer(self._framer.scan_silence())

    def _answer(self, found: list[Frame | FrameError]) -> None:
        adus = bytearray()
        for each in found:
            if isinstance(each, FrameError):
                logger.debug("%s: %s: %s", self._peer, each, each.received.hex(" "))
                self._units.note_damage(overrun=each.overrun)
                continue
            if self._delivery is not None:
                self._answer_with_faults(each, self._delivery)
            elif (answer := self._units.answer(each, self._peer)) is not None:
                adus += self._framer.encode(answer)
            self._follow_delimiter()
        if adus:
            self._write(bytes(adus))

    def _answer_with_faults(self, request: Frame, delivery: Delivery) -> None:
        fault = None
        if self._units.faults is not None and self._units.answers(request):
            has_transaction = isinstance(self._framer, TcpFramer)
            fault = self._units.faults.due(request, has_transaction=has_transaction)
        if fault is not None and fault.code is not None:
            answer: Frame | None = self._units.refuse(request, fault.code)
        else:
            answer = self._units.answer(request, self._peer)
        if answer is not None:
            delivery.send(pieces(fault, answer, self._framer))

    def _follow_delimiter(self) -> None:
        """From the frame behind the answer on, both ways."""
        if isinstance(self._framer, AsciiFramer) and self._units.delimiter is not None:
            self._framer.delimiter = self._units.delimiter


class _Connection(asyncio.BufferedProtocol):
    """One client over TCP; among its peers from before it is made until it is lost."""

    transport: asyncio.Transport | None = None
    stopped = False
    # Whether the client does not take its answers.
    is_full = False

    def __init__(
        self,
        units: TcpUnits | SerialUnits,
        framing: str,
        buffer: memoryview,
        peers: set[_Connection],
    ) -> None:
        self._units = units
        self._framing = framing
        self._buffer = buffer
        self._peers = peers
        peers.add(self)

    def stop(self) -> None:
        self.stopped = True
        if self.transport is not None:
            self.transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        host, port, *_ = transport.get_extra_info("peername")
        self._session = _Session(
            self._units, self._framing, f"{host}:{port}", transport.write, self._follow
        )
        transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        if self.stopped:
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._session.close()
        self._peers.discard(self)

    def get_buffer(self, sizehint: int) -> memoryview:
        # One buffer for all: it is emptied before the loop turns to the next client.
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        try:
            self._session.receive(bytes(self._buffer[:nbytes]))
        except FrameError as error:
            assert self.transport is not None
            logger.debug("connection closed: %s", error)
            self.transport.close()

    def pause_writing(self) -> None:
        self.is_full = True
        self._follow()

    def resume_writing(self) -> None:
        self.is_full = False
        self._follow()

    def _follow(self) -> None:
        """Read only while the answers get away."""
        assert self.transport is not None
        if self.is_full or self._session.is_waiting:
            self.transport.pause_reading()
        else:
            self.transport.resume_reading()


@contextlib.asynccontextmanager
async def _serve_tcp(endpoint: url.Endpoint, units: Units) -> AsyncIterator[url.Endpoint]:
    loop = asyncio.get_running_loop()
    peers: set[_Connection] = set()
    own = TcpUnits(units) if endpoint.framing == "tcp" else SerialUnits(units)
    make = partial(_Connection, own, endpoint.framing, memoryview(bytearray(READ_SIZE)), peers)
    try:
        addresses = await loop.getaddrinfo(
            endpoint.host, endpoint.port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )
        hosts = list(dict.fromkeys(str(address[0]) for *_, address in addresses))
        # A free port is free on one address; on the next it may be taken.
        bound = hosts if endpoint.port else hosts[0]
        server = await loop.create_server(make, bound, endpoint.port, backlog=1024)
    except OSError as error:
        raise ModbusConnectionError(
            f"cannot listen on {endpoint}: {_reason(error)}", errno=error.errno
        ) from error
    try:
        yield replace(endpoint, port=server.sockets[0].getsockname()[1])
    finally:
        await _stop(server, peers)


async def _stop(server: asyncio.Server, peers: set[_Connection]) -> None:
    """Accept no more, and see every connection off."""
    loop = asyncio.get_running_loop()
    for listener in server.sockets:
        # Server.close would spoil what was accepted in this turn of the loop and
        # gets its transport in the next.
        loop.remove_reader(listener.fileno())
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(STOP_WITHIN):
            await asyncio.sleep(0)
            while peers:
                for peer in peers:
                    peer.stop()
                await asyncio.sleep(0)
            server.close()
            await server.wait_closed()
    server.close()


def _reason(error: OSError) -> str:
    """The system's own words; asyncio's are long, and getaddrinfo's numbers negative."""
    number = error.errno or 0
    return os.strerror(number) if number > 0 else str(error.strerror or error)


@contextlib.asynccontextmanager
async def _serve_serial(endpoint: url.Endpoint, units: Units) -> AsyncIterator[url.Endpoint]:
    port = _Port(SerialLink(endpoint.device, **endpoint.options), endpoint, units)
    port.open()
    try:
        yield endpoint
    finally:
        port.stop()


class _Port:
    """One serial port; opened again when it was unplugged and comes back."""

    def __init__(self, link: SerialLink, endpoint: url.Endpoint, units: Units) -> None:
        self._link = link
        self._endpoint = endpoint
        self._units = SerialUnits(units)
        self._loop = asyncio.get_running_loop()
        self._retry: asyncio.TimerHandle | None = None
        self._unsent = bytearray()
        self._sending: asyncio.TimerHandle | None = None
        self._sender = ThreadPoolExecutor(1, "serial port")  # one, to keep the order

    def open(self) -> None:
        self._link.open(time.monotonic())
        self._session = _Session(
            self._units, self._endpoint.framing, self._endpoint.device, self._write
        )
        self._loop.add_reader(self._link.descriptor, self._read)

    def stop(self) -> None:
        if self._retry is not None:
            self._retry.cancel()
        self.close()
        self._sender.shutdown(wait=False)

    def close(self) -> None:
        if self._link.is_open:
            self._session.close()
            self._loop.remove_reader(self._link.descriptor)
            self._link.close()

    def _read(self) -> None:
        try:
            self._session.receive(self._link.receive(0))
        except ModbusConnectionError as error:
            logger.warning("%s: %s; waiting for it to come back", self._endpoint, error)
            self.close()
            self._retry = self._loop.call_later(REOPEN_AFTER, self._reopen)

    def _reopen(self) -> None:
        try:
            self.open()
            logger.warning("%s: is back", self._endpoint)
        except ModbusConnectionError:
            self._retry = self._loop.call_later(REOPEN_AFTER, self._reopen)

    def _write(self, data: bytes) -> None:
        """Answer after the silence that ends the request (serial line, 2.5.1.1)."""
        self._unsent += data
        wait = self._link.time_to_silence() if self._endpoint.framing == "rtu" else 0
        if wait <= 0:
            self._send_unsent()
        elif self._sending is None:
            self._sending = self._loop.call_later(wait, self._send_unsent)

    def _send_unsent(self) -> None:
        data, self._unsent, self._sending = bytes(self._unsent), bytearray(), None
        self._send(data)

    def _send(self, data: bytes) -> None:
        if not self._link.is_open:
            return
        if self._link.rs485 in self._link.rts_modes:
            # It waits while the bits go out, and the loop has others to serve.
            self._loop.run_in_executor(self._sender, self._send_now, data)
        else:
            self._send_now(data)

    def _send_now(self, data: bytes) -> None:
        # The port takes a whole answer at once, or nobody reads at the other
        # end: then there is nothing to wait for. A port that is gone shows
        # in the next read.
        with contextlib.suppress(ModbusTimeoutError, ModbusConnectionError):
            self._link.send(data, time.monotonic())
