"""
What happened in a gateway: in all, by line, and by unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ...client.statistics import Statistics

__all__ = ["GatewayStatistics", "LineStatistics", "UnitStatistics"]


@dataclass(slots=True)
class UnitStatistics:
    """
    What became of the requests for one unit of a line.

    Attributes:
        requests: that were sent to it.
        answers: that came and fit, refusals included.
        exceptions: refusals among them.
        timeouts: requests that it did not answer in time.
        invalid: those whose answer was none.
        lost: those for which there was no connection, or not to the end.
        resting: those answered with 0B at once, for it gave no answer before.
        given_up: those that tried whether it is back, and made way for others.
        cached: those answered with what was read before.
        merged: those answered with an equal one.
        seconds: that its answers took, in all.
        is_silent: whether it gave no answer the last time.
    """

    requests: int = 0
    answers: int = 0
    exceptions: int = 0
    timeouts: int = 0
    invalid: int = 0
    lost: int = 0
    resting: int = 0
    given_up: int = 0
    cached: int = 0
    merged: int = 0
    seconds: float = 0.0
    is_silent: bool = False


@dataclass(slots=True)
class LineStatistics:
    """
    What happened on one line.

    Attributes:
        url: where it leads.
        connection: of its connection; `late_answers` are those that were dropped.
        units: by unit, as the line has them; those that were asked.
        waiting: requests that wait for their turn now.
        in_flight: those that wait for their answer now.
        full: those that got 06: too many waited, or they waited for too long.
        unwanted: answers that came when nobody waited any more, and were not passed on.
    """

    url: str
    connection: Statistics
    units: dict[int, UnitStatistics] = field(default_factory=dict)
    waiting: int = 0
    in_flight: int = 0
    full: int = 0
    unwanted: int = 0

    def unit(self, number: int) -> UnitStatistics:
        """Give those of a unit."""
        found = self.units.get(number)
        if found is None:
            found = self.units[number] = UnitStatistics()
        return found


@dataclass(slots=True, weakref_slot=True)
class GatewayStatistics:
    """
    What happened in a gateway since it was made.

    Attributes:
        lines: by URL; those that there are now.
        requests: that came from clients and were looked at.
        no_route: those that got 0A.
        refused: those that a route, or `authorize`, does not allow.
        malformed: those that cannot be passed on: no function, or a wrong length.
        broadcasts: writes for all units of a line.
    """

    lines: dict[str, LineStatistics] = field(default_factory=dict)
    requests: int = 0
    no_route: int = 0
    refused: int = 0
    malformed: int = 0
    broadcasts: int = 0
