"""
Authorization of every request, before anything else is done (MB-TCP-Security-v36, R-24 to R-31).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..protocol.errors import IllegalFunction
from ..protocol.logs import HarmlessLogger
from ..protocol.pdu import Request
from .access import Access
from .hooks import timed

__all__ = ["Asked", "Authorization", "Authorize", "UnauthorizedError"]

logger: HarmlessLogger = HarmlessLogger(__name__)

MINUTE_S = 60.0

LINES_PER_MINUTE = 20
"""The most lines of log in a minute; 1 for each role on each host."""


@dataclass(frozen=True, slots=True)
class Asked:
    """
    A request and its client, as they are passed to `authorize`.

    Attributes:
        role: the role in the client's certificate; None without a role, or without TLS.
        unit: the unit of the request, 0..255; on serial lines 0 stands for all units.
        peer: the client: "192.0.2.7:51234", or the serial port.
        function: the function code, 0..127.
        request: the decoded request; None if it cannot be decoded because its function is unknown,
            or a length, quantity or constant is wrong.
        writes: the accesses that write to tables and files, with the values.
        reads: the accesses that read tables, files and queues.
    """

    role: str | None
    unit: int
    peer: str
    function: int
    request: Request[Any] | None = None
    writes: tuple[Access, ...] = ()
    reads: tuple[Access, ...] = ()


Authorize = Callable[[Asked], bool]


class UnauthorizedError(IllegalFunction):
    """The request is not allowed: exception 1 (R-31)."""


class Authorization:
    """Decides about each request, and logs few refusals, so that a client cannot fill the log."""

    def __init__(
        self, authorize: Authorize, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._authorize = timed("authorize", authorize)
        self._clock = clock
        self._minute = -MINUTE_S
        self._logged: set[tuple[str, str | None]] = set()
        self._not_logged = 0

    def check(self, asked: Asked) -> None:
        """
        Check that a request is allowed.

        Raises:
            UnauthorizedError: the request is not allowed.
            TypeError: `authorize` returned neither True nor False, such as a coroutine.
        """
        allowed = self._authorize(asked)
        if allowed is True:
            return
        if allowed is not False:
            # A truthy value may be a mistake, and a mistake must not allow access.
            given = type(allowed).__name__
            raise TypeError(f"authorize must return True or False, not {given}")
        self._log(asked)
        raise UnauthorizedError("not allowed", function=asked.function)

    def _log(self, asked: Asked) -> None:
        now = self._clock()
        if now - self._minute >= MINUTE_S:
            if self._not_logged:
                logger.warning("%d more requests were refused like this", self._not_logged)
            self._minute, self._not_logged = now, 0
            self._logged.clear()
        # A client can use any number of ports, so only the host counts.
        who = asked.peer.rpartition(":")[0] or asked.peer, asked.role
        if who in self._logged or len(self._logged) >= LINES_PER_MINUTE:
            self._not_logged += 1
            return
        self._logged.add(who)
        role = "without a role" if asked.role is None else f"with the role {asked.role!r}"
        touched = [f"write {_range_text(each)}" for each in asked.writes[:1]]
        touched += [f"read {_range_text(each)}" for each in asked.reads[:1]]
        what = ", ".join([f"function {asked.function} of unit {asked.unit}", *touched])
        logger.warning("%s, %s, may not use %s", asked.peer or "a caller", role, what)


def _range_text(access: Access) -> str:
    table = f"file {access.file}" if access.table == "file" else access.table
    return f"{table} {access.address}..{access.address + access.count - 1}"
