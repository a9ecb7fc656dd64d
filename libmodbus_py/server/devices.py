"""
The service of devices: each request is answered at once, by the device of its unit.
"""

from __future__ import annotations

from ..ports.endpoint import Endpoint
from .by_chunk import ByChunk, Singles
from .by_frame import ByFrame
from .framed import AT_ONCE, Echoes
from .limits import ServerStatistics
from .service import Channel, Later, MakeSession, Session
from .units import SerialUnits, TcpUnits, Units

__all__ = ["Devices"]


class Devices:
    """See `Service`."""

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
        framing = endpoint.framing
        at_once = None if later is None else AT_ONCE
        echoes = Echoes(endpoint, statistics)

        def by_frame(units: TcpUnits | SerialUnits, channel: Channel) -> Session:
            return ByFrame(
                units,
                framing,
                channel,
                statistics,
                at_once,
                is_datagram=endpoint.is_datagram,
                pause=endpoint.pause,
                echoes=echoes,
            )

        if not endpoint.has_transactions:
            line = SerialUnits(self._units)
            self._of_endpoints.append(line)
            if endpoint.is_serial:
                return lambda channel: by_frame(line, channel)
            return lambda channel: by_frame(line.of_connection(), channel)
        own = TcpUnits(self._units)
        self._of_endpoints.append(own)
        if later is None:
            return lambda channel: by_frame(own, channel)
        singles = Singles(own, statistics, later)
        return lambda channel: ByChunk(own, channel, statistics, singles)
