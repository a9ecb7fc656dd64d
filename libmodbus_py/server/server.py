"""
The server: many clients, many units, many endpoints, in one asyncio loop.

An endpoint (`tcp`, `udp`, `serial`) takes bytes to a session (`by_chunk`, `by_frame`),
which takes requests to the device of their unit, and the answers go back in order of
arrival. Nobody waits for anybody.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import logging
import signal
import threading
from collections.abc import AsyncIterator, Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from ..device.device import Device
from ..device.reply import replier
from ..ports.endpoint import Endpoint, parse
from ..ports.tls import security_of
from ..security.security import Security
from .background import Background
from .faults import Fault, Faults
from .limits import Limits, ServerStatistics
from .peers import Peers
from .serial import SerialServer
from .sources import Sources
from .tcp import TcpServer
from .udp import UdpServer
from .units import Units, UnknownUnit

__all__ = ["Running", "Server"]

logger: logging.Logger = logging.getLogger(__name__)


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
        own_unit: which of several devices the server itself is: on TCP and UDP it answers
            units 0 and 255, too, unless they have devices of their own. One device alone
            always does. None: none of them.
        security: who it is and whom it trusts, for tls; the URLs may say it instead.

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
        own_unit: int | None = None,
        security: Security | None = None,
    ) -> None:
        self.statistics: ServerStatistics = ServerStatistics()
        made = Faults({} if faults is None else faults)
        self._units = Units(devices, made, unknown_unit, own_unit, self._note_unauthorized)
        if not isinstance(limits, Limits | None):
            raise TypeError(f"limits must be Limits, not {type(limits).__name__}")
        self._limits = limits or Limits()
        if not isinstance(security, Security | None):
            raise TypeError(f"security must be Security, not {type(security).__name__}")
        self._security = security

    @contextlib.asynccontextmanager
    async def serving(self, *urls: str) -> AsyncIterator[Running]:
        """
        Serve while the ``async with`` block runs.

        Args:
            urls: where to listen: tcp, rtu+tcp, ascii+tcp, udp, tls with port 0 for a free
                one; rtu, ascii for serial ports with their settings.

        Raises:
            TypeError, ValueError: a URL is wrong or has options of clients, or there is none.
            ModbusConnectionError: an endpoint cannot be opened, with errno.

        SystemExit and KeyboardInterrupt that a hook raises close all endpoints, once the requests
        that were read are answered, and leave the loop.
        """
        endpoints = [_endpoint(url) for url in urls]
        if not endpoints:
            raise ValueError("urls must name at least one endpoint")
        replier()  # its descriptors, before clients take the last ones
        sources = Sources(self._limits, self.statistics)
        with contextlib.ExitStack() as stack:
            # At once, when a hook ends the program: others that are ready must not be called.
            peers = Peers(self._limits, self.statistics, stack.close)
            stack.callback(peers.close)
            opened = []
            for endpoint in endpoints:
                server = self._make(endpoint, peers, sources, stack.close)
                stack.callback(server.close)
                opened.append(await server.open())
            running = Running([str(endpoint) for endpoint in opened])
            for url in running.urls:
                logger.info("listening on %s", url)
            yield running

    def background(self, *urls: str) -> Background[Running]:
        """
        Serve in a thread of its own while the ``with`` block runs.

        When it is left, by Ctrl-C too, the thread has ended and all is closed.

        Arguments and exceptions as for `serving`, when the block is entered. SystemExit and
        KeyboardInterrupt that a hook raises end the server at once, and are raised here when
        the block is left.
        """
        return Background(lambda: self.serving(*urls))

    def serve_forever(
        self, *urls: str, on_listening: Callable[[Running], object] = lambda running: None
    ) -> None:
        """
        Serve until SIGTERM or Ctrl-C: for a program that does nothing else.

        Both end it well: it sees the clients off and returns. In another thread than
        the main one no signal comes, and it serves as long as the process lives (daemon=True).
        Nothing is printed; the log has ``listening on URL`` at INFO.

        Args:
            urls: as for `serving`.
            on_listening: called once, when all endpoints are open.

        Raises:
            RuntimeError: an event loop runs in this thread: use `serving`.

        Other exceptions as for `serving`, and those of `on_listening`.
        """

        async def serve() -> None:
            stopped = asyncio.Event()
            with _signals_call(stopped.set):
                async with self.serving(*urls) as running:
                    # Else every full search for garbage looks through all that was
                    # imported: 5 ms in which nobody is answered.
                    gc.collect()
                    gc.freeze()
                    on_listening(running)
                    await stopped.wait()

        asyncio.run(serve())

    def _note_unauthorized(self) -> None:
        self.statistics.unauthorized += 1

    def _make(
        self, endpoint: Endpoint, peers: Peers, sources: Sources, end: Callable[[], None]
    ) -> TcpServer | UdpServer | SerialServer:
        if endpoint.transport == "tcp":
            return TcpServer(endpoint, self._units, peers)
        if endpoint.transport == "tls":
            security = security_of(endpoint, self._security)
            return TcpServer(endpoint, self._units, peers, security)
        if endpoint.transport == "udp":
            return UdpServer(endpoint, self._units, sources, self.statistics, end)
        return SerialServer(endpoint, self._units, self.statistics, end)


def _endpoint(url: str) -> Endpoint:
    endpoint = parse(url)
    if endpoint.client_options:
        names = ", ".join(endpoint.client_options)
        raise ValueError(f"{url!r}: {names} is for clients, and means nothing to a server")
    return endpoint


@contextlib.contextmanager
def _signals_call(stop: Callable[[], object]) -> Iterator[None]:
    """Have SIGTERM and Ctrl-C do this, in the main thread of a running loop."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    loop = asyncio.get_running_loop()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        loop.add_signal_handler(number, stop)
    try:
        yield
    finally:
        for number, handler in before.items():
            loop.remove_signal_handler(number)
            signal.signal(number, handler)
