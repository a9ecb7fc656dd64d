"""
Serving: endpoints from URLs, in a loop, in a thread, or for ever.

Subclasses of `Serving` choose the service that answers there.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import weakref
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from ..ports.endpoint import Endpoint, parse_to_listen
from ..ports.schemes import Transport
from ..ports.trace import OnTraced
from ..protocol.checks import checked_callback
from ..protocol.logs import HarmlessLogger
from .background import Background
from .forever import Handler, frozen_garbage, signal_handlers
from .limits import Limits, ServerStatistics
from .peers import Peers
from .service import Service, explained
from .tcp import TcpServer
from .tracing import TracedService, Traces
from .udp import Sources, UdpServer

if TYPE_CHECKING:
    from ..security.security import Security
    from .audit import Audit, OnAudited
    from .serial import SerialServer

__all__ = ["Running", "Serving"]

logger: HarmlessLogger = HarmlessLogger(__name__)


@dataclass(frozen=True)
class Running:
    """
    A running server.

    Attributes:
        urls: the URLs of its endpoints, in the order given, with the ports that the system chose.
    """

    urls: list[str]


class Serving(ABC):
    """
    The base of servers and gateways: opens endpoints, and serves at them.

    Args:
        limits: limits of connections and requests; None for the defaults of `Limits`.
        security: the certificates of the server and of trusted clients, for tls; URLs may contain
            them instead.
        trace: called in the loop with a `Traced` for every ADU received and sent; the logger
            ``libmodbus_py.wire`` gets the same at DEBUG. Whether tracing is on is
            checked when a connection is made, or a port opened. If the function fails or takes
            long, this is logged once, and requests are not affected; SystemExit and
            KeyboardInterrupt end the server.
        audit: called with an `AuditEvent` for each write, and for each request and connection
            that is refused; an `Audit` can refuse writes while the function fails.

    Attributes:
        statistics: counters of all endpoints, kept up to date.

    Raises:
        TypeError: an argument has the wrong type.
    """

    def __init__(
        self,
        limits: Limits | None = None,
        security: Security | None = None,
        trace: OnTraced | None = None,
        audit: Audit | OnAudited | None = None,
    ) -> None:
        self.statistics: ServerStatistics = ServerStatistics()
        if not isinstance(limits, Limits | None):
            raise TypeError(f"limits must be Limits, not {type(limits).__name__}")
        self._limits = limits or Limits()
        if security is not None:
            _check_security(security)
        self._security = security
        self._secured: weakref.WeakSet[TcpServer] = weakref.WeakSet()
        self._traces = Traces(None if trace is None else _checked(trace))
        self._auditor: Audit | None = None
        if audit is not None:
            from .audit import audit_of

            self._auditor = audit_of(audit)
        self._listening: list[Endpoint] = []

    @property
    def security(self) -> Security | None:
        """
        The certificates of the server and of trusted clients; None if URLs contain them.

        They can be replaced while the server runs: new connections use the new ones at once, and
        open connections whose client is no longer trusted are closed within
        `Limits.certificate_interval`. `Security.reload` reads the same files again.

        Raises:
            TypeError, ValueError: it is set to something that is no `Security`, or to one that a
                server cannot use.
        """
        return self._security

    @security.setter
    def security(self, security: Security) -> None:
        _check_security(security)
        security.check_server()
        self._security = security
        for server in list(self._secured):
            server.use(security)

    @contextlib.asynccontextmanager
    async def serving(self, *urls: str) -> AsyncIterator[Running]:
        """
        Serve while the ``async with`` block runs.

        Args:
            urls: the endpoints, of any scheme: hosts, whose port may be 0 for a free one, and
                serial ports with their settings.

        Returns:
            A context manager; ``async with`` returns a `Running` with the URLs in use.

        Raises:
            TypeError, ValueError: a URL is wrong or has options of clients, or there is none.
            ModbusConnectionError: an endpoint cannot be opened, with errno.

        If a hook raises SystemExit or KeyboardInterrupt, all endpoints are closed once the requests
        that were read are answered, and the exception leaves the event loop.
        """
        endpoints = [parse_to_listen(url) for url in urls]
        if not endpoints:
            raise ValueError("urls must name at least one endpoint")
        auditor = self._auditor
        sources = Sources(self._limits, self.statistics, auditor)
        async with self._answering(endpoints) as answering:
            service = TracedService(answering, self._traces)
            with contextlib.ExitStack() as stack:
                # At once, when a hook ends the program: others that are ready must not be called.
                with explained("cannot serve"):
                    peers = Peers(self._limits, self.statistics, stack.close, auditor=auditor)
                stack.callback(peers.close)
                opened = []
                for endpoint in endpoints:
                    shared = Shared(
                        peers, sources, self.statistics, self._security, self._secured, stack.close
                    )
                    server = ENDPOINTS[endpoint.transport](endpoint, service, shared)
                    stack.callback(server.close)
                    with explained(f"cannot listen on {endpoint}"):
                        opened.append(await server.open())
                self._listening = opened
                running = Running([str(endpoint) for endpoint in opened])
                for url in running.urls:
                    logger.info("listening on %s", url)
                    if auditor is not None:
                        auditor.note_own("start", url)
                        stack.callback(auditor.note_own, "stop", url)
                yield running

    def background(self, *urls: str) -> Background[Running]:
        """
        Serve in a separate thread while the ``with`` block runs.

        When the block has been left, even by Ctrl-C, the thread has ended and all endpoints are
        closed; if Ctrl-C comes right before the end of the block, they end soon after.

        The arguments are those of `serving`, and its exceptions are raised when the block is
        entered. If a hook raises SystemExit or KeyboardInterrupt, the server ends at once, and the
        exception is raised when the block is left.
        """
        return Background(lambda: self.serving(*urls))

    def serve_forever(
        self,
        *urls: str,
        on_listening: Callable[[Running], object] = lambda running: None,
        on_hangup: Callable[[], object] | None = None,
    ) -> None:
        """
        Serve until SIGTERM or Ctrl-C, for a program that does nothing else.

        Both signals close all connections properly, and the method returns. Only the main thread
        receives signals; in another thread, the method serves as long as the process lives, so that
        the thread should be a daemon. Nothing is printed; the log gets ``listening on URL`` at
        INFO.

        Args:
            urls: as for `serving`.
            on_listening: called once with the `Running` server, when all endpoints are open.
            on_hangup: called in the loop when SIGHUP arrives, for example to `Server.replace`
                devices or to `Gateway.change_routes`; None leaves SIGHUP as it is.

        Raises:
            RuntimeError: an event loop runs in this thread; use `serving` there.
            TypeError: `on_listening` or `on_hangup` is not a function.

        It also raises the exceptions of `serving` and of `on_listening`.
        """

        checked_callback("on_listening", on_listening)
        if on_hangup is not None:
            checked_callback("on_hangup", on_hangup)

        async def serve() -> None:
            stopped = asyncio.Event()
            handlers: dict[signal.Signals, Handler] = {
                signal.SIGINT: stopped.set,
                signal.SIGTERM: stopped.set,
            }
            if on_hangup is not None:
                handlers[signal.SIGHUP] = on_hangup
            with signal_handlers(handlers):
                async with self.serving(*urls) as running:
                    with frozen_garbage():
                        on_listening(running)
                        await stopped.wait()

        asyncio.run(serve())

    def tracing(self, callback: OnTraced) -> AbstractContextManager[None]:
        """
        Call another function with every ADU, like `trace`, while the ``with`` block runs.

        Connections that are made meanwhile are traced; earlier ones only if they were
        traced already.

        Args:
            callback: called in the server's loop with a `Traced`.

        Raises:
            TypeError: the callback is not a function.
        """
        return self._traces.with_another(_checked(callback))

    @abstractmethod
    def _answering(self, endpoints: list[Endpoint]) -> AbstractAsyncContextManager[Service]:
        """Return a context manager with the service that answers at these endpoints."""


class Shared(NamedTuple):
    """
    The parts that all endpoints of a server share.

    Attributes:
        peers: the TCP connections of all endpoints.
        sources: the known clients of all UDP endpoints.
        statistics: of the server.
        security: of the server; None if it has none.
        secured: the endpoints that use it.
        end: closes all endpoints.
    """

    peers: Peers
    sources: Sources
    statistics: ServerStatistics
    security: Security | None
    secured: weakref.WeakSet[TcpServer]
    end: Callable[[], None]


# Each imports what only its transport needs.


def _tls_server(endpoint: Endpoint, service: Service, shared: Shared) -> TcpServer:
    from ..ports.tls import security_of

    security = security_of(endpoint, shared.security)
    server = TcpServer(endpoint, service, shared.peers, security)
    if security is shared.security:
        shared.secured.add(server)
    return server


def _unix_server(endpoint: Endpoint, service: Service, shared: Shared) -> TcpServer:
    from ..ports.unix import UnixListener

    return TcpServer(endpoint, service, shared.peers, listener=UnixListener(endpoint.path))


def _serial_server(endpoint: Endpoint, service: Service, shared: Shared) -> SerialServer:
    from .serial import SerialServer  # which not every system has

    return SerialServer(endpoint, service, shared.statistics, shared.end)


ENDPOINTS: dict[
    Transport, Callable[[Endpoint, Service, Shared], TcpServer | UdpServer | SerialServer]
] = {
    "tcp": lambda endpoint, service, shared: TcpServer(endpoint, service, shared.peers),
    "udp": lambda endpoint, service, shared: UdpServer(
        endpoint, service, shared.sources, shared.statistics, shared.end
    ),
    "tls": _tls_server,
    "unix": _unix_server,
    "serial": _serial_server,
}
"""Transport -> function that makes the endpoint of a server."""


def _check_security(security: object) -> None:
    from ..security.security import Security

    if not isinstance(security, Security):
        raise TypeError(f"security must be Security, not {type(security).__name__}")


def _checked(trace: OnTraced) -> OnTraced:
    return checked_callback("trace", trace)
