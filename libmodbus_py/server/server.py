"""
The server: many clients, many units, many endpoints, in one asyncio loop.

An endpoint (`tcp_server`, `udp_server`, `serial_server`) takes bytes to a session, the
session takes requests to the device of their unit, and the answers go back in order of
arrival. Nobody waits for anybody.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import ClassVar

from ..device.device import Device
from ..device.reply import replier
from ..ports import endpoint as url
from .faults import Fault, Faults
from .limits import Limits, ServerStatistics
from .peers import Peers
from .serial import SerialServer
from .tcp import TcpServer
from .udp import UdpServer
from .units import Units, UnknownUnit

__all__ = ["Running", "Server"]

AnyServer = TcpServer | UdpServer | SerialServer


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

    On serial lines, and such lines over TCP, a unit without a device is silent, and unit 0
    is a broadcast: writes go to every device, nobody answers.

    Args:
        devices: ``{unit 0..255: device}``, or one device that answers every unit.
        faults: ``{unit 0..255: faults}``, what goes wrong with the answers of a unit;
            None is every unit.
        limits: what clients may cost; None for the defaults of `Limits`.
        unknown_unit: what a unit without a device gets on TCP and UDP: "refuse", exception
            11; "silent", nothing.

    Attributes:
        statistics: what happened at all endpoints, kept up to date.

    Raises:
        TypeError, ValueError: an argument is something else.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
        limits: Limits | None = None,
        unknown_unit: UnknownUnit = "refuse",
    ) -> None:
        self._units = Units(devices, Faults({} if faults is None else faults), unknown_unit)
        if not isinstance(limits, Limits | None):
            raise TypeError(f"limits must be Limits, not {type(limits).__name__}")
        self._limits = limits or Limits()
        self.statistics = ServerStatistics()

    @contextlib.asynccontextmanager
    async def serving(self, *urls: str) -> AsyncIterator[Running]:
        """
        Serve while the ``async with`` block runs.

        Args:
            urls: where to listen (`libmodbus_py.url`): tcp, rtu+tcp, ascii+tcp, udp
                with port 0 for a free one; rtu, ascii for serial ports.

        Raises:
            TypeError, ValueError: a URL is wrong, or there is none.
            ModbusConnectionError: an endpoint cannot be opened, with errno.
        """
        endpoints = [url.parse(address) for address in urls]
        if not endpoints:
            raise ValueError("urls must name at least one endpoint")
        replier()  # its descriptors, before clients take the last ones
        peers = Peers(self._limits, self.statistics)
        with contextlib.ExitStack() as stack:
            stack.callback(peers.close)
            opened = []
            for endpoint in endpoints:
                server = self._make[endpoint.transport](self, endpoint, peers)
                stack.callback(server.close)
                opened.append(await server.open())
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

    def _tcp(self, endpoint: url.Endpoint, peers: Peers) -> TcpServer:
        return TcpServer(endpoint, self._units, peers)

    def _udp(self, endpoint: url.Endpoint, _: Peers) -> UdpServer:
        return UdpServer(endpoint, self._units, self._limits, self.statistics)

    def _serial(self, endpoint: url.Endpoint, _: Peers) -> SerialServer:
        return SerialServer(endpoint, self._units, self.statistics)

    _make: ClassVar[dict[str, Callable[[Server, url.Endpoint, Peers], AnyServer]]] = {
        "tcp": _tcp,
        "udp": _udp,
        "serial": _serial,
    }
