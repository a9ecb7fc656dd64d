"""The gateway: clients on any endpoints, devices on any lines."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable

from ...device.authorization import Authorize
from ...ports.endpoint import Endpoint
from ...ports.trace import OnTraced
from ...protocol.checks import checked_callback
from ...protocol.logs import HarmlessLogger
from ...protocol.mistakes import named_arguments
from ...security.security import Security
from ...server.audit import Audit, OnAudited
from ...server.limits import Limits
from ...server.service import Service
from ...server.serving import Serving
from ..tasks import KeptTasks
from .dispatcher import Dispatcher, ResolvedRoute
from .line import GatewayLine
from .routes import GatewayOptions, Route, check_line, check_routes
from .statistics import GatewayStatistics, UnitStatistics, own_device

logger: HarmlessLogger = HarmlessLogger(__name__)


@named_arguments
class Gateway(Serving):
    """
    Forwards requests to the devices of lines, and their responses to the clients.

    Requests of any function are forwarded, as bytes. A client gets exception 10 for a unit without
    a route, 11 for a unit that does not answer, 6 if too many requests wait. Clients take turns.
    A unit that does not answer is paused, longer each time, and then tried when no other request
    waits; until it answers, requests to it get exception 11 at once.

    Unit 0 is a broadcast unless it has a route: writes are sent to every line. A broadcast gets
    exception 6 while an equal one of another client is sent, and for a second after it, because it
    may have come back through another gateway.

    Args:
        routes: the lines, and the units that are reached over each.
        own_units: the units of the gateway itself, whose input registers contain its statistics;
            units with a route are excepted.
        queue: waiting requests per client, 1..1024.
        longest_wait: seconds that a request may wait, 0.001..86400; then it gets exception 6.
        writes_first: True to let writes overtake waiting reads.
        limits: limits for clients; None for the defaults of `Limits`.
        security: the certificate of the gateway and those it trusts, for tls; the options of the
            URLs may contain them instead.
        authorize: decides whether a request is allowed, such as `Rules`. It is called in the
            event loop of the gateway with a `ClientRequest`, whose `unit` is that which the client
            sent, also for requests to the gateway itself. A request that is not allowed gets
            exception 1.
        trace: called with a `TracedFrame` for every ADU received from clients and sent to them, as
            for `Server`.
        audit: called with an `AuditEvent` for each write, each request and connection that is
            refused; an `Audit` to refuse writes while it fails.

    Attributes:
        statistics: counters of all endpoints, kept up to date.
        traffic: counters of requests, by line and by unit.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range; two routes for one unit;
            two routes to the same host and port or serial port with different options.
    """

    def __init__(
        self,
        routes: Iterable[Route],
        *,
        own_units: str | Iterable[int] = (255,),
        queue: int = 16,
        longest_wait: float = 5.0,
        writes_first: bool = False,
        limits: Limits | None = None,
        security: Security | None = None,
        authorize: Authorize | None = None,
        trace: OnTraced | None = None,
        audit: Audit | OnAudited | None = None,
    ) -> None:
        super().__init__(limits, security, trace, audit)
        self._routes = _checked(routes)
        self._options = GatewayOptions(own_units, queue, longest_wait, writes_first)
        if authorize is not None:
            checked_callback("authorize", authorize)
        self._authorize = authorize
        self.traffic: GatewayStatistics = GatewayStatistics()
        self._dispatcher: Dispatcher | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing = KeptTasks()

    @property
    def routes(self) -> list[Route]:
        """The lines, and the units that are reached over each."""
        return list(self._routes)

    def change_routes(self, routes: Iterable[Route]) -> None:
        """
        Replace the routes, from any thread.

        Connections of clients are kept, and so are connections to lines whose URL does not change.

        Raises:
            TypeError, ValueError: as for `Gateway`, or a new line leads to no serial port or to
                an endpoint of the gateway itself. The routes do not change then.
        """
        new_routes = _checked(routes)
        before = {route.endpoint.url for route in self._routes}
        if self._loop is not None:
            for at, route in enumerate(new_routes):
                if route.endpoint.url not in before:
                    check_line(("routes", at, "url"), route.endpoint, self._listening)
        self._routes = new_routes
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._change_lines)

    @contextlib.asynccontextmanager
    async def _answering(self, endpoints: list[Endpoint]) -> AsyncIterator[Service]:
        if self._dispatcher is not None:
            raise RuntimeError("this gateway is already serving; make another one")
        for at, route in enumerate(self._routes):
            check_line(("routes", at, "url"), route.endpoint, endpoints)
        own = own_device(self.traffic, self.statistics, self._unit_statistics, self._authorize)
        # As many requests as may wait, and as many as may be in flight.
        most = 2 * self._options.queue + 16
        dispatcher = self._dispatcher = Dispatcher(
            own, self._options.own, most, self._authorize, self.traffic, self._auditor, self._log
        )
        self._loop = asyncio.get_running_loop()
        try:
            self._change_lines()
            yield dispatcher
        finally:
            self._loop = self._dispatcher = None
            for line in dispatcher.lines:
                self._closing.begin(line.close())
            if self._closing:
                await asyncio.wait(self._closing)

    def _change_lines(self) -> None:
        dispatcher = self._dispatcher
        if dispatcher is None:
            return
        before = {line.endpoint.url: line for line in dispatcher.lines}
        lines: dict[str, GatewayLine] = {}
        ways: dict[int, ResolvedRoute] = {}
        for route in self._routes:
            key = route.endpoint.url
            if key in before:
                lines[key] = before.pop(key)
            elif key not in lines:
                lines[key] = GatewayLine(route.endpoint, self._options)
            for unit, device_unit in route.ways.items():
                ways[unit] = ResolvedRoute(lines[key], device_unit, route)
        dispatcher.lines, dispatcher.routes = list(lines.values()), ways
        self.traffic.lines = {line.url: line.statistics for line in lines.values()}
        for line in before.values():
            self._closing.begin(line.close())

    def _unit_statistics(self, unit: int) -> UnitStatistics | None:
        way = None if self._dispatcher is None else self._dispatcher.routes.get(unit)
        return None if way is None else way.line.statistics.units.get(way.unit)


def _checked(routes: Iterable[Route]) -> list[Route]:
    if isinstance(routes, Route) or not isinstance(routes, Iterable):
        raise TypeError(f"routes must be a list of routes, not {type(routes).__name__}")
    route_list = list(routes)
    if not route_list:
        raise ValueError("routes must hold at least one")
    check_routes(route_list)
    return route_list
