"""
The server of devices: many clients, many units, many endpoints, in one asyncio loop.

An endpoint (`tcp`, `udp`, `serial`) takes bytes to a session (`sessions`),
which takes requests to the device of their unit, and the answers go back in order of
arrival. No client waits for another one.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from typing import TYPE_CHECKING

from ..device.device import Device
from ..device.reply import replier
from ..ports.endpoint import Endpoint
from ..ports.trace import OnTraced
from .framed import SessionSettings
from .limits import Limits, ServerStatistics
from .service import Later, MakeSession, Service, explained
from .serving import Running, Serving
from .sessions import ByChunk, ByFrame, Singles
from .units import SerialUnits, TcpUnits, Units, UnknownUnit

if TYPE_CHECKING:
    from ..security.security import Security
    from .audit import Audit, OnAudited

__all__ = ["DeviceServer", "Devices", "Running"]


class DeviceServer(Serving):
    """
    A server that answers requests from devices; they may be replaced while it runs.

    A subclass calls `serve_units` before the server is started. Arguments as for `Server`.
    """

    def __init__(
        self,
        limits: Limits | None = None,
        unknown_unit: UnknownUnit = "refuse",
        own_unit: int | None = None,
        security: Security | None = None,
        trace: OnTraced | None = None,
        audit: Audit | OnAudited | None = None,
    ) -> None:
        super().__init__(limits, security, trace, audit)
        self._unknown_unit: UnknownUnit = unknown_unit
        self._own_unit = own_unit
        self._answering_now: list[tuple[asyncio.AbstractEventLoop, Devices]] = []

    def units_of(self, devices: Device | Mapping[int, Device]) -> Units:
        """Return devices as the units of this server, or raise TypeError or ValueError."""
        return Units(
            devices, self._unknown_unit, self._own_unit, self._note_unauthorized, self._auditor
        )

    def serve_units(self, units: Units) -> None:
        """Answer from these units from now on, in each loop between two requests."""
        self._units = units
        for loop, answering in list(self._answering_now):
            if loop is _running_loop():
                answering.change(units)
            else:
                with contextlib.suppress(RuntimeError):  # the loop has just ended
                    loop.call_soon_threadsafe(self._renew, answering)

    def _renew(self, answering: Devices) -> None:
        answering.change(self._units)

    @contextlib.asynccontextmanager
    async def _answering(self, endpoints: list[Endpoint]) -> AsyncIterator[Service]:
        with explained("cannot serve"):
            replier()  # creates its descriptors, before clients take the last ones
        answering = Devices(self._units)
        now = asyncio.get_running_loop(), answering
        self._answering_now.append(now)
        try:
            self._renew(answering)  # another thread may have replaced them in between
            yield answering
        finally:
            self._answering_now.remove(now)

    def _note_unauthorized(self) -> None:
        self.statistics.unauthorized += 1


class Devices:
    """The service of devices: each request is answered at once. See `Service`."""

    def __init__(self, units: Units) -> None:
        self._units = units
        self._of_endpoints: list[TcpUnits | SerialUnits] = []

    def change(self, units: Units) -> None:
        """Replace the units from the next request on, on all connections; in their loop."""
        self._units = units
        for each in self._of_endpoints:
            each.change(units)

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        settings = SessionSettings(endpoint, statistics, has_turns=later is not None)
        if not endpoint.has_transactions:
            line = SerialUnits(self._units)
            self._of_endpoints.append(line)
            if endpoint.is_serial:
                return lambda channel: ByFrame(settings, line, channel)
            return lambda channel: ByFrame(settings, line.of_connection(), channel)
        own = TcpUnits(self._units)
        self._of_endpoints.append(own)
        if later is None:
            return lambda channel: ByFrame(settings, own, channel)
        singles = Singles(own, statistics, later)
        return lambda channel: ByChunk(settings, own, channel, singles)


def _running_loop() -> asyncio.AbstractEventLoop | None:
    with contextlib.suppress(RuntimeError):
        return asyncio.get_running_loop()
    return None
