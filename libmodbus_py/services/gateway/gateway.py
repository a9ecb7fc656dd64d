"""
The gateway: clients on any endpoints, devices behind any lines.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Iterable
from warnings import warn

from ...device.authorization import Authorize
from ...ports.endpoint import Endpoint
from ...ports.trace import OnTraced
from ...security.security import Security
from ...server.limits import Limits
from ...server.service import Service
from ...server.serving import Serving
from .dispatcher import Answering, Dispatcher, ResolvedRoute
from .line import GatewayLine
from .loops import check_line
from .options import GatewayOptions
from .own_device import own_device
from .routes import Route, by_unit
from .statistics import GatewayStatistics, UnitStatistics

__all__ = ["Gateway"]

logger: logging.Logger = logging.getLogger(__name__)


class Gateway(Serving):
    """
    Passes requests on to the devices of other lines, and their answers back.

    Any function goes through, as bytes. A client gets exception 10 for a unit without a route,
    11 for one that gives no answer, 6 when too many requests wait. Clients take turns. A unit
    that gave no answer is left alone for a while, for longer each time, and tried when nobody
    else waits; until then its requests get 11 at once.

    Unit 0 is a broadcast where it has no route: writes go to every line.

    Args:
        routes: which units are reached over which lines.
        own_units: under which units the gateway itself is found, with its statistics as input
            registers, where there is no route for them.
        queue: how many requests of one client may wait, 1..1024.
        longest_wait: seconds after which a request does not wait for its turn any more and gets
            exception 6, 0.001..86400.
        writes_first: whether requests that may write overtake those that only read.
        limits: what clients may cost; None for the defaults of `Limits`.
        security: who the gateway is and whom it trusts, for tls; the URLs may say it instead.
        authorize: says whether a request is allowed, such as `Rules`; called with an `Asked`,
            whose `unit` is the client's, in the loop of the gateway; about requests to the
            gateway itself, too. Refused is answered with exception 1.
        trace: called with a `Traced` for every ADU that clients send and get, as of `Server`.

    Attributes:
        statistics: what happened at all endpoints, kept up to date.
        traffic: what happened to requests: by line, and by unit.

    Raises:
        TypeError, ValueError: an argument is something else; two routes for one unit, or two
            with other options to one place.
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
    ) -> None:
        super().__init__(limits, security, trace)
        self._routes = _checked(routes)
        self._options = GatewayOptions(own_units, queue, longest_wait, writes_first)
        if not (authorize is None or callable(authorize)):
            raise TypeError(f"authorize must be a function, not {type(authorize).__name__}")
        self._authorize = authorize
        self.traffic: GatewayStatistics = GatewayStatistics()
        self._answering_now: Answering | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._closing: set[asyncio.Task[None]] = set()

    @property
    def passed(self) -> GatewayStatistics:
        """The old name of `traffic`."""
        warn("Gateway.passed is now Gateway.traffic", DeprecationWarning, stacklevel=2)
        return self.traffic

    def change_routes(self, routes: Iterable[Route]) -> None:
        """
        Replace the routes, from any thread.

        Connections of clients stay, and those to lines that a route leads to as before.

        Raises:
            TypeError, ValueError: as when it was made; a new line leads to no port, or to
                where the gateway listens. Then nothing changes.
        """
        checked = _checked(routes)
        before = {route.endpoint.url for route in self._routes}
        new = [route for route in checked if route.endpoint.url not in before]
        if self._loop is not None:
            self._check_lines(new, self._listening)
        self._routes = checked
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._change_lines)

    @contextlib.asynccontextmanager
    async def _answering(self, endpoints: list[Endpoint]) -> AsyncIterator[Service]:
        if self._answering_now is not None:
            raise RuntimeError("this gateway serves already; make one for each")
        self._check_lines(self._routes, endpoints)
        own = own_device(self.traffic, self.statistics, self._unit_statistics, self._authorize)
        answering = self._answering_now = Answering(own, self._options.own)
        self._loop = asyncio.get_running_loop()
        try:
            self._change_lines()
            # As many as may wait, and as many as may be in flight.
            most = 2 * self._options.queue + 16
            yield Dispatcher(answering, most, self._authorize, self.traffic)
        finally:
            self._loop = self._answering_now = None
            async with contextlib.AsyncExitStack() as stack:  # each, whatever ends this
                stack.push_async_callback(_all, list(self._closing))
                for line in answering.lines:
                    stack.push_async_callback(line.close)

    def _check_lines(self, routes: Iterable[Route], listening: list[Endpoint]) -> None:
        for at, route in enumerate(routes):
            check_line(("routes", at, "to"), route.endpoint, listening)

    def _change_lines(self) -> None:
        answering = self._answering_now
        if answering is None:
            return
        before = {line.key: line for line in answering.lines}
        lines: dict[str, GatewayLine] = {}
        ways: dict[int, ResolvedRoute] = {}
        for route in self._routes:
            key = route.endpoint.url
            line = lines.get(key) or before.pop(key, None) or self._line(route)
            lines[key] = line
            for unit, device_unit in route.ways.items():
                ways[unit] = ResolvedRoute(line, device_unit, route.cache, route.merge, route.allow)
        answering.lines, answering.routes = list(lines.values()), ways
        self.traffic.lines = {line.url: line.statistics for line in lines.values()}
        for line in before.values():
            closing = asyncio.get_running_loop().create_task(line.close())
            self._closing.add(closing)
            closing.add_done_callback(self._closing.discard)

    def _line(self, route: Route) -> GatewayLine:
        return GatewayLine(route.endpoint, self._options)

    def _unit_statistics(self, unit: int) -> UnitStatistics | None:
        answering = self._answering_now
        way = None if answering is None else answering.routes.get(unit)
        return None if way is None else way.line.statistics.units.get(way.unit)


def _checked(routes: Iterable[Route]) -> list[Route]:
    if isinstance(routes, Route) or not isinstance(routes, Iterable):
        raise TypeError(f"routes must be a list of routes, not {type(routes).__name__}")
    given = list(routes)
    if not given:
        raise ValueError("routes must hold at least one")
    by_unit(given)
    return given


async def _all(tasks: list[asyncio.Task[None]]) -> None:
    """Wait for them, however they end."""
    await asyncio.gather(*tasks, return_exceptions=True)
