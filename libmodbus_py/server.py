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
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial

from . import url
from .arguments import integer
from .device import Device
from .errors import (
    FrameError,
    GatewayTargetFailedToRespond,
    ModbusConnectionError,
    ModbusTimeoutError,
)
from .framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer
from .pdu import REQUESTS
from .serial_link import SerialLink

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

    Raises:
        TypeError, ValueError: `devices` is something else.
    """

    def __init__(self, devices: Device | Mapping[int, Device]) -> None:
        self._units = _Units(devices)

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


class _Units:
    """Finds the device of a frame."""

    def __init__(self, devices: Device | Mapping[int, Device]) -> None:
        self._any = devices if isinstance(devices, Device) else None
        self._devices: dict[int, Device] = {}
        if self._any is not None:
            return
        if not isinstance(devices, Mapping):
            given = type(devices).__name__
            raise TypeError(f"devices must be a Device or {{unit: Device}}, not {given}")
        for unit, device in devices.items():
            if not isinstance(device, Device):
                raise TypeError(f"devices[{unit!r}] must be a Device, not {type(device).__name__}")
            self._devices[integer("unit", unit, 0, 255)] = device

    def answer(self, frame: Frame, *, serial: bool) -> Frame | None:
        unit, pdu, transaction = frame
        if serial and unit == 0:
            self._broadcast(pdu)
            return None
        device = self._any or self._devices.get(unit)
        if device is not None:
            response = device.answer(pdu)
        elif serial or pdu[0] & 0x80:
            return None
        else:
            response = bytes([pdu[0] | 0x80, GatewayTargetFailedToRespond.code])
        return Frame(unit, response, transaction) if response else None

    def _broadcast(self, pdu: bytes) -> None:
        request = REQUESTS.get(pdu[0])
        if request is not None and request.is_write:
            for device in {self._any} if self._any else set(self._devices.values()):
                device.answer(pdu)


class _Session:
    """One connection or one port: bytes in, answers out."""

    def __init__(self, units: _Units, framing: str, write: Callable[[bytes], None]) -> None:
        self._units = units
        self._framer = FRAMERS[framing]()
        self._write = write
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None

    def receive(self, data: bytes) -> None:
        """
        Take received bytes, write the answers.

        Raises:
            FrameError: the stream must be closed; what could be answered was.
        """
        self._answer(partial(self._framer.feed, data))
        if not self._framer.in_step:
            self._framer.feed(b"")
        self.close()
        if self._framer.quiet and self._framer.pending:
            self._timer = self._loop.call_later(self._framer.quiet, self._silence)

    def close(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _silence(self) -> None:
        self._answer(self._framer.silence)

    def _answer(self, take: Callable[[], list[Frame]]) -> None:
        try:
            frames = take()
        except FrameError as error:
            logger.debug("%s: %s", error, error.received.hex(" "))
            return
        serial = self._framer.has_broadcast
        answers = [self._units.answer(frame, serial=serial) for frame in frames]
        adus = [self._framer.encode(answer) for answer in answers if answer is not None]
        if adus:
            self._write(b"".join(adus))


class _Connection(asyncio.BufferedProtocol):
    """One client over TCP; among its peers from before it is made until it is lost."""

    transport: asyncio.Transport | None = None
    stopped = False

    def __init__(
        self, units: _Units, framing: str, buffer: memoryview, peers: set[_Connection]
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
        self._session = _Session(self._units, self._framing, transport.write)
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
            logger.debug("%s: closed: %s", self.transport.get_extra_info("peername"), error)
            self.transport.close()

    def pause_writing(self) -> None:
        assert self.transport is not None
        self.transport.pause_reading()

    def resume_writing(self) -> None:
        assert self.transport is not None
        self.transport.resume_reading()


@contextlib.asynccontextmanager
async def _serve_tcp(endpoint: url.Endpoint, units: _Units) -> AsyncIterator[url.Endpoint]:
    loop = asyncio.get_running_loop()
    peers: set[_Connection] = set()
    make = partial(_Connection, units, endpoint.framing, memoryview(bytearray(READ_SIZE)), peers)
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
async def _serve_serial(endpoint: url.Endpoint, units: _Units) -> AsyncIterator[url.Endpoint]:
    port = _Port(SerialLink(endpoint.device, **endpoint.options), endpoint, units)
    port.open()
    try:
        yield endpoint
    finally:
        port.close()


class _Port:
    """One serial port; opened again when it was unplugged and comes back."""

    def __init__(self, link: SerialLink, endpoint: url.Endpoint, units: _Units) -> None:
        self._link = link
        self._endpoint = endpoint
        self._units = units
        self._loop = asyncio.get_running_loop()
        self._retry: asyncio.TimerHandle | None = None

    def open(self) -> None:
        self._link.open(time.monotonic())
        self._session = _Session(self._units, self._endpoint.framing, self._write)
        self._loop.add_reader(self._link.descriptor, self._read)

    def close(self) -> None:
        if self._retry is not None:
            self._retry.cancel()
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
        # The port takes a whole answer at once, or nobody reads at the other
        # end: then there is nothing to wait for.
        with contextlib.suppress(ModbusTimeoutError):
            self._link.send(data, time.monotonic())
