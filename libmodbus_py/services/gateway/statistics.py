"""
Counters of a gateway: of all requests, by line, and by unit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ...client.statistics import Statistics

__all__ = ["GatewayStatistics", "LineStatistics", "UnitStatistics"]


@dataclass(slots=True)
class UnitStatistics:
    """
    Counters of the requests to one unit of a line.

    Attributes:
        requests: requests sent to the unit.
        answers: valid responses of the unit, exceptions included.
        exceptions: exception responses of the unit.
        timeouts: requests without a response in time.
        invalid: requests with an invalid response.
        lost: requests without a connection, or whose connection was lost.
        resting: requests answered with exception 11 at once because the unit, or the function
            of the unit, was silent.
        given_up: trials of a silent unit that were ended because other requests waited.
        cached: requests answered from the cache.
        merged: requests answered with the response to an equal request.
        seconds: total response time, in seconds.
        is_silent: True if the unit rests, because it answers nothing.
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
    Counters of one line.

    Attributes:
        url: the URL of the line.
        connection: the statistics of its client; `late_answers` were dropped.
        units: the counters of each unit that requests were sent to, by its number on the line.
        waiting: requests in the queue now.
        in_flight: requests that wait for their response now.
        full: requests refused with exception 6 because the queue was full, or after a long wait.
        unwanted: responses dropped because the client did not wait any more.
        trouble: why there is no connection now; empty if there is one, or none was wanted.
        since: since when that is so, in seconds since the epoch; 0 before the first connection.
    """

    url: str
    connection: Statistics
    units: dict[int, UnitStatistics] = field(default_factory=dict)
    waiting: int = 0
    in_flight: int = 0
    full: int = 0
    unwanted: int = 0
    trouble: str = ""
    since: float = 0.0

    def unit(self, number: int) -> UnitStatistics:
        """Return the counters of a unit."""
        found = self.units.get(number)
        if found is None:
            found = self.units[number] = UnitStatistics()
        return found


@dataclass(slots=True, weakref_slot=True)
class GatewayStatistics:
    """
    Counters of a gateway since it was made.

    Attributes:
        lines: the counters of the current lines, by URL.
        requests: requests received from clients.
        no_route: requests refused because there is no route for their unit.
        refused: requests not allowed by a route or by `authorize`.
        malformed: requests refused because of an invalid function code or a wrong length.
        broadcasts: writes to unit 0, sent to all lines.
    """

    lines: dict[str, LineStatistics] = field(default_factory=dict)
    requests: int = 0
    no_route: int = 0
    refused: int = 0
    malformed: int = 0
    broadcasts: int = 0
