"""
Serving: endpoints from URLs, in a loop, in a thread, or for ever.

Subclasses of `Serving` choose the service that answers there: that of `Server` are the devices of
many units. An endpoint (`peers`, `udp`, `serial`) takes bytes to a session (`sessions`),
which takes requests to the device of their unit, and the answers go back in order of
arrival. No client waits for another one.
"""

from __future__ import annotations

import asyncio
import contextlib
import signal
import weakref
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from dataclasses import dataclass
from typing import TYPE_CHECKING, NoReturn

from ..device.authorization import LimitedLog, in_time
from ..device.hooks import timed
from ..ports.endpoint import Endpoint, parse_to_listen
from ..ports.trace import OnTraced, Trace, TracedFrame, is_traced
from ..protocol.checks import checked_callback
from ..protocol.logs import HarmlessLogger
from .limits import Limits, ServerStatistics
from .peers import Peers, TcpServer
from .running import Background, Handler, frozen_garbage, signal_handlers
from .service import ENDS, Channel, Later, MakeSession, Service, Session, explained
from .udp import Sources, UdpServer

if TYPE_CHECKING:
    from ..security.security import Security
    from .audit import Audit, OnAudited
    from .serial import SerialServer

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

    The arguments are those of `Server`.

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
        self._traces = Traces(trace)
        self._log = LimitedLog(logger)
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
        auditor, log = self._auditor, self._log
        sources = Sources(self._limits, self.statistics, auditor, log)
        async with self._answering(endpoints) as answering:
            service = TracedService(answering, self._traces)
            with contextlib.ExitStack() as stack:
                # At once, when a hook ends the program: others that are ready must not be called.
                with explained("cannot serve"):
                    peers = Peers(
                        self._limits, self.statistics, stack.close, auditor=auditor, log=log
                    )
                stack.callback(peers.close)
                stack.enter_context(in_time())
                listening = []
                for endpoint in endpoints:
                    server = self._make_endpoint(endpoint, service, peers, sources, stack.close)
                    stack.callback(server.close)
                    with explained(f"cannot listen on {endpoint}"):
                        listening.append(await server.open())
                self._listening = listening
                running = Running([str(endpoint) for endpoint in listening])
                for url in running.urls:
                    logger.info("listening on %s", url)
                    if auditor is not None:
                        auditor.note_own("start", url)
                        stack.callback(auditor.note_own, "stop", url)
                yield running

    def _make_endpoint(
        self,
        endpoint: Endpoint,
        service: Service,
        peers: Peers,
        sources: Sources,
        end: Callable[[], None],
    ) -> TcpServer | UdpServer | SerialServer:
        """Return the endpoint of a transport; each imports what only it needs."""
        if endpoint.transport == "serial":
            from .serial import SerialServer  # which not every system has

            return SerialServer(endpoint, service, self.statistics, end)
        if endpoint.transport == "udp":
            return UdpServer(endpoint, service, sources, self.statistics, end)
        if endpoint.transport == "unix":
            from ..ports.unix import UnixListener

            return TcpServer(endpoint, service, peers, listener=UnixListener(endpoint.path))
        if endpoint.transport == "tls":
            from ..ports.tls import security_of

            security = security_of(endpoint, self._security)
            server = TcpServer(endpoint, service, peers, security)
            if security is self._security:
                self._secured.add(server)
            return server
        return TcpServer(endpoint, service, peers)

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
            stop = asyncio.Event()
            handlers: dict[signal.Signals, Handler] = {
                signal.SIGINT: stop.set,
                signal.SIGTERM: stop.set,
            }
            if on_hangup is not None:
                handlers[signal.SIGHUP] = on_hangup
            with signal_handlers(handlers):
                async with self.serving(*urls) as running:
                    with frozen_garbage():
                        on_listening(running)
                        await stop.wait()

        asyncio.run(serve())

    def tracing(self, callback: OnTraced) -> AbstractContextManager[None]:
        """
        Call another function with every ADU, like `trace`, while the ``with`` block runs.

        Connections that are made meanwhile are traced; earlier ones only if they were
        traced already.

        Args:
            callback: called in the server's loop with a `TracedFrame`.

        Raises:
            TypeError: the callback is not a function.
        """
        return self._traces.with_another(_harmless(callback))

    @abstractmethod
    def _answering(self, endpoints: list[Endpoint]) -> AbstractAsyncContextManager[Service]:
        """Return a context manager with the service that answers at these endpoints."""


def _check_security(security: object) -> None:
    from ..security.security import Security

    if not isinstance(security, Security):
        raise TypeError(f"security must be Security, not {type(security).__name__}")


# --- traces: functions that are called with every ADU --------------------------------------------


class Traces:
    """The functions that are called with ADUs; they can change, in any thread."""

    def __init__(self, first: OnTraced | None) -> None:
        self._all: tuple[OnTraced, ...] = () if first is None else (_harmless(first),)

    def __bool__(self) -> bool:
        return bool(self._all)

    def __call__(self, frame: TracedFrame) -> None:
        for callback in self._all:
            callback(frame)

    @contextlib.contextmanager
    def with_another(self, callback: OnTraced) -> Iterator[None]:
        self._all += (callback,)
        try:
            yield
        finally:
            self._all = tuple(other for other in self._all if other is not callback)


class TracedService:
    """A service whose sessions report their ADUs, if tracing is on when they are made."""

    def __init__(self, service: Service, traces: Traces) -> None:
        self._service = service
        self._traces = traces

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        make = self._service.sessions(endpoint, statistics, later)
        url, traces = str(endpoint), self._traces

        def make_traced(channel: Channel) -> Session:
            is_on = is_traced(traces or None)
            channel.trace = Trace(url, traces, channel.address) if is_on else None
            return make(channel)

        return make_traced


def _harmless(callback: OnTraced) -> OnTraced:
    """
    Return a callback whose exceptions cost no client an answer.

    A failure is logged once, and a long duration once: a client must not be able to
    fill the log. SystemExit and KeyboardInterrupt leave the loop when this turn is over.
    """
    call = timed("trace", callback)
    has_failed = False

    def harmless(frame: TracedFrame) -> None:
        nonlocal has_failed
        try:
            call(frame)
        except ENDS as error:
            asyncio.get_running_loop().call_soon(_raise, error)
        except BaseException:
            if not has_failed:
                has_failed = True
                logger.exception("trace(%s) failed; this is logged once", frame)

    return harmless


def _raise(error: BaseException) -> NoReturn:
    raise error
