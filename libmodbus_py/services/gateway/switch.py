"""
The service of a gateway: each request goes to the line of its unit, and answers come later.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field

from ...device.authorization import Asked, Authorization, Authorize, UnauthorizedError
from ...device.device import Caller, Device
from ...device.rules import Allow
from ...ports.endpoint import Endpoint
from ...protocol.errors import (
    ExceptionResponse,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalFunction,
    ServerDeviceBusy,
    ServerDeviceFailure,
)
from ...protocol.framing import Frame
from ...server.framed import AT_ONCE, Framed
from ...server.limits import ServerStatistics
from ...server.service import Channel, Later, MakeSession
from .line import Forwarded, Line
from .passed import Passed, passed
from .statistics import GatewayStatistics

__all__ = ["Answering", "ForwardingSession", "Switch", "Way"]

logger: logging.Logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Way:
    """
    How a unit is reached.

    Attributes:
        unit: what it is on the line.
        cache: seconds that an answer may be old.
        merge: whether equal reads that wait are asked once.
        allow: what may be done; None for everything.
    """

    line: Line
    unit: int
    cache: float = 0.0
    merge: bool = False
    allow: Allow | None = None


@dataclass(slots=True)
class Answering:
    """
    Who answers which unit; it may be changed while sessions last.

    Attributes:
        ways: unit -> how it is reached.
        lines: all of them, for broadcasts.
        own: the device that the gateway is, and `own_units`, under which it is.
    """

    own: Device
    own_units: frozenset[int]
    ways: dict[int, Way] = field(default_factory=dict)
    lines: list[Line] = field(default_factory=list)


class Switch:
    """
    See `Service`.

    Args:
        answering: who answers.
        most_of_session: how many requests of one connection may be unanswered.
        authorize: says whether a request is allowed; None for all.
        statistics: where it is counted.
    """

    def __init__(
        self,
        answering: Answering,
        most_of_session: int,
        authorize: Authorize | None,
        statistics: GatewayStatistics,
    ) -> None:
        self.answering = answering
        self.most_of_session = most_of_session
        self.statistics = statistics
        self.now: Callable[[], float] = asyncio.get_running_loop().time
        self._guard = None if authorize is None else Authorization(authorize)
        self._has_failed = False

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        has_ids = endpoint.has_transactions
        at_once = None if has_ids or later is None else AT_ONCE

        def make(channel: Channel) -> ForwardingSession:
            return ForwardingSession(self, endpoint, channel, statistics, at_once)

        return make

    def ask(self, session: ForwardingSession, frame: Frame) -> bytes | None:
        """Give the response PDU; None if it comes later, or never."""
        unit, pdu, number = frame
        self.statistics.requests += 1
        if pdu[0] & 0x80:
            return None
        answering = self.answering
        way = answering.ways.get(unit)
        if way is None:
            if unit in answering.own_units:
                caller = Caller(unit, session.peer, role=session.role)
                return answering.own.answer(pdu, caller) or None
            if unit or not answering.lines:
                return self._refuse_route(session, pdu)
        try:
            request = passed(pdu)
        except ExceptionResponse as refusal:
            self.statistics.malformed += 1
            return self._exception(session, pdu, refusal.code)
        if way is None:
            return self._broadcast(session, frame, request)
        if (self._guard or way.allow) and (code := self._check(session, unit, request, way.allow)):
            return self._exception(session, pdu, code)
        now = self.now()
        age = way.cache if request.is_read else 0.0
        if age and (answer := way.line.cached(way.unit, request, age, now)):
            return answer
        if session.count >= self.most_of_session:
            way.line.statistics.full += 1
            return self._exception(session, pdu, ServerDeviceBusy.code)
        forwarded = Forwarded(session, number, unit, way.unit, request, now, age)
        session.note(forwarded, way.line)
        code = way.line.put(forwarded, merge=way.merge and request.is_read)
        if not code:
            return None
        session.forget(forwarded)
        return self._exception(session, pdu, code)

    def _exception(self, session: ForwardingSession, pdu: bytes, code: int) -> bytes:
        return bytes([pdu[0] | 0x80, code])

    def _refuse_route(self, session: ForwardingSession, pdu: bytes) -> bytes | None:
        """On a serial line the unit may be somebody else, who answers."""
        self.statistics.no_route += 1
        if session.is_line:
            return None
        return self._exception(session, pdu, GatewayPathUnavailable.code)

    def _check(
        self, session: ForwardingSession, unit: int, request: Passed, allow: Allow | None
    ) -> int:
        """Give 0, or the code of the exception that refuses it."""
        who = unit, session.peer, session.role
        touched = request.touches(who)
        asked = Asked(session.role, unit, session.peer, request.function, request.known, *touched)
        try:
            if self._guard is not None:
                self._guard.check(asked)
        except UnauthorizedError as refusal:
            session.statistics.unauthorized += 1
            self.statistics.refused += 1
            return refusal.code
        except ExceptionResponse as refusal:
            return refusal.code
        except (SystemExit, KeyboardInterrupt):
            raise
        except BaseException:
            if not self._has_failed:  # once: a client must not be able to fill the log
                self._has_failed = True
                logger.exception("authorize failed; answered with exception 4")
            return ServerDeviceFailure.code
        if allow is not None and not _allows(allow, asked):
            self.statistics.refused += 1
            return IllegalFunction.code
        return 0

    # --- broadcasts ---------------------------------------------------------------------------

    def _broadcast(self, session: ForwardingSession, frame: Frame, request: Passed) -> bytes | None:
        """What is no write cannot be one: nobody would answer."""
        if not request.is_write:
            return self._refuse_route(session, frame.pdu)
        ways = {way.line: way for way in self.answering.ways.values()}
        for way in ways.values():
            if code := self._check(session, 0, request, way.allow):
                return self._exception(session, frame.pdu, code)
        self.statistics.broadcasts += 1
        Broadcast(session, frame, request, self.now()).ask(list(ways))
        return None


def _allows(allow: Allow, asked: Asked) -> bool:
    """What cannot be decoded might be anything."""
    return asked.request is not None and allow.allows(asked)


class Broadcast:
    """
    A write to all units of all lines.

    It is done when all lines have sent it.
    """

    def __init__(
        self, session: ForwardingSession, frame: Frame, request: Passed, since: float
    ) -> None:
        self.host: Hashable = session.host
        self._session = session
        self._request = request
        self._whole = Forwarded(session, frame.transaction, 0, 0, request, since)
        self._left = 0
        self._has_failed = False

    def ask(self, lines: list[Line]) -> None:
        self._left = len(lines)
        self._session.note(self._whole, None)
        for line in lines:
            part = Forwarded(self, 0, 0, 0, self._request, self._whole.waits_since)
            if line.put(part):
                self.told(part, b"\x80")

    def told(self, forwarded: Forwarded, response: bytes | None) -> None:
        self._left -= 1
        self._has_failed = self._has_failed or (response is not None and response[0] >= 0x80)
        if self._left:
            return
        refusal = bytes([self._request.function | 0x80, GatewayTargetFailedToRespond.code])
        is_told = self._has_failed and self._session.has_ids
        self._whole.tell(refusal if is_told else None)


# --- sessions ---------------------------------------------------------------------------------


class ForwardingSession(Framed):
    """
    What one client asks, and the answers when they come.

    Who writes over TCP or UDP what nobody answers gets the answer of a write when it was sent: no
    client there knows of broadcasts, and all would wait.

    Without transaction ids the client that asks again has given up what it asked before: its
    answer is dropped, or it would be taken for that to the new request.
    """

    def __init__(
        self,
        switch: Switch,
        endpoint: Endpoint,
        channel: Channel,
        statistics: ServerStatistics,
        at_once: int | None,
    ) -> None:
        super().__init__(endpoint.framing, channel, statistics, at_once)
        self.peer: str = channel.address
        self.role: str | None = channel.role
        self.host: Hashable = channel.address.rpartition(":")[0] or channel.address
        self.statistics = statistics
        self.has_ids: bool = endpoint.has_transactions
        self.is_line: bool = endpoint.is_serial
        self._switch = switch
        # What is unanswered, and the line that it goes over.
        self._asked: dict[Forwarded, Line | None] = {}

    @property
    def is_owing(self) -> bool:
        return bool(self._asked)

    @property
    def count(self) -> int:
        """How many requests are unanswered."""
        return len(self._asked)

    def note(self, forwarded: Forwarded, line: Line | None) -> None:
        """A request waits for its answer."""
        self._asked[forwarded] = line

    def forget(self, forwarded: Forwarded) -> None:
        self._asked.pop(forwarded, None)

    def told(self, forwarded: Forwarded, response: bytes | None) -> None:
        self.forget(forwarded)
        if response is None and self.has_ids and forwarded.request.is_write:
            response = forwarded.request.response_to_broadcast()
        if response is not None:
            self._send(Frame(forwarded.from_unit, response, forwarded.number))
        if not self._asked:
            self._channel.follow()

    def end(self) -> None:
        """A client that is gone must not cost the others turns."""
        super().end()
        for forwarded in [each for each in self._asked if each.submitted is None]:
            self._withdraw(forwarded)

    def close(self) -> None:
        super().close()
        self._withdraw_all()

    def _answer(self, request: Frame) -> Frame | None:
        if self._asked and not self.has_ids:
            self._withdraw_all()
        response = self._switch.ask(self, request)
        return None if response is None else request._replace(pdu=response)

    def _withdraw_all(self) -> None:
        for forwarded in list(self._asked):
            self._withdraw(forwarded)

    def _withdraw(self, forwarded: Forwarded) -> None:
        line = self._asked.pop(forwarded)
        if line is None:
            forwarded.asker = None
        else:
            line.drop(forwarded)
