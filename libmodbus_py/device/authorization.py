"""
Who may do what: asked before anything else about every request (MB-TCP-Security-v36, R-24 to
R-31).
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..protocol.errors import IllegalFunction
from ..protocol.pdu import Request
from .access import Access
from .hooks import timed

__all__ = ["Asked", "Authorization", "Authorize", "UnauthorizedError"]

logger: logging.Logger = logging.getLogger(__name__)

MINUTE = 60.0

MOST_LINES = 20
"""How many lines the log gets in a minute; 1 of each role on each host."""


@dataclass(frozen=True, slots=True)
class Asked:
    """
    A request, and who sends it: what authorisation decides on.

    Attributes:
        role: what the certificate of the client says of it; None for nothing, or without TLS.
        unit: who is asked, 0..255; 0 on serial lines are all.
        peer: who asks: "192.0.2.7:51234", or the serial port.
        function: the function code, 0..127.
        request: what is asked; None for what no request can be decoded from: an unknown
            function, or wrong lengths, quantities and constants.
        writes: what it writes in tables, files and queues, with the values.
        reads: what it reads in them.
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
    """
    Asks about each request, and says in the log who was refused, but not more often than
    `MOST_LINES` times a minute: a client must not be able to fill the log.

    Args:
        authorize: says True for what may be done, False for what may not.
        clock: gives seconds.
    """

    def __init__(
        self, authorize: Authorize, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if not callable(authorize):
            raise TypeError(f"authorize must be a function, not {type(authorize).__name__}")
        self._authorize = timed("authorize", authorize)
        self._clock = clock
        self._minute = -MINUTE
        self._told: set[tuple[str, str | None]] = set()
        self._untold = 0

    def check(self, asked: Asked) -> None:
        """
        Raises:
            UnauthorizedError: it is not allowed.
            TypeError: the answer was neither True nor False, such as a coroutine's.
        """
        allowed = self._authorize(asked)
        if allowed is True:
            return
        if allowed is not False:
            # What counts as true might be a mistake, and a mistake must not open doors.
            given = type(allowed).__name__
            raise TypeError(f"authorize must give True or False, not {given}")
        self._tell(asked)
        raise UnauthorizedError("not allowed", function=asked.function)

    def _tell(self, asked: Asked) -> None:
        now = self._clock()
        if now - self._minute >= MINUTE:
            if self._untold:
                logger.warning("%d more requests were refused like this", self._untold)
            self._minute, self._untold = now, 0
            self._told.clear()
        # A client has as many ports as it likes.
        who = asked.peer.rpartition(":")[0] or asked.peer, asked.role
        if who in self._told or len(self._told) >= MOST_LINES:
            self._untold += 1
            return
        self._told.add(who)
        role = "without a role" if asked.role is None else f"with the role {asked.role!r}"
        touched = [f"write {_place(each)}" for each in asked.writes[:1]]
        touched += [f"read {_place(each)}" for each in asked.reads[:1]]
        what = ", ".join([f"function {asked.function} of unit {asked.unit}", *touched])
        logger.warning("%s, %s, may not use %s", asked.peer or "a caller", role, what)


def _place(access: Access) -> str:
    table = f"file {access.file}" if access.table == "file" else access.table
    return f"{table} {access.address}..{access.address + access.count - 1}"
