"""The service of a gateway: sends each request to the line of its unit; responses come later."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Hashable
from typing import NamedTuple

from ...device import authorization
from ...device.access import Auditor, Caller, ExecutedRequest, Who, changes_of, touched
from ...device.authorization import (
    Allow,
    Authorization,
    Authorize,
    ClientRequest,
    LimitedLog,
    UnauthorizedError,
)
from ...device.device import Device
from ...ports.endpoint import Endpoint
from ...ports.hosts import host_of_peer, is_loopback
from ...protocol import errors
from ...protocol.errors import ExceptionResponse
from ...protocol.framing import Frame
from ...protocol.logs import HarmlessLogger
from ...server.framed import FrameServer, SessionSettings
from ...server.limits import ServerStatistics, host_of
from ...server.service import Channel, Later, MakeSession
from .line import ForwardedRequest, GatewayLine, RequestBytes, request_of
from .routes import Route
from .statistics import GatewayStatistics

logger: HarmlessLogger = HarmlessLogger(__name__)

RETURN_S = 1.0
"""The time after a broadcast in which it may come back through other gateways."""


class ResolvedRoute(NamedTuple):
    """The line of one unit, its number there, and the route with its options."""

    line: GatewayLine
    unit: int
    route: Route


class Dispatcher:
    """See `Service`; `own` is the gateway itself as a device. Routes may change at any time."""

    def __init__(
        self,
        own: Device,
        own_units: frozenset[int],
        most_of_session: int,
        authorize: Authorize | None,
        statistics: GatewayStatistics,
        auditor: Auditor | None = None,
        log: LimitedLog | None = None,
    ) -> None:
        self.auditor = auditor
        self.routes: dict[int, ResolvedRoute] = {}
        self.lines: list[GatewayLine] = []
        self.statistics = statistics
        self.now: Callable[[], float] = asyncio.get_running_loop().time
        self._own, self._own_units = own, own_units
        self._most_of_session = most_of_session
        self._log = log or LimitedLog(logger)
        self._guard = None if authorize is None else Authorization(authorize, self._log)
        self._has_failed = False
        # PDU -> the broadcast of it that is being sent, or was sent a moment ago.
        self._broadcasts: dict[bytes, Broadcast] = {}

    def sessions(
        self, endpoint: Endpoint, statistics: ServerStatistics, later: Later | None = None
    ) -> MakeSession:
        has_turns = later is not None and not endpoint.has_transactions
        settings = SessionSettings(endpoint, statistics, has_turns=has_turns)
        return lambda channel: ForwardingSession(self, settings, channel)

    def has_unit(self, unit: int) -> bool:
        """Return True if a unit is the gateway itself, or has a route."""
        return unit in self.routes or unit in self._own_units

    def ask(self, session: ForwardingSession, frame: Frame) -> bytes | None:
        """Return the response PDU; None if it comes later, or never."""
        unit, pdu, _ = frame
        self.statistics.requests += 1
        if pdu[0] & 0x80:
            return None
        way = self.routes.get(unit)
        if way is None:
            if unit in self._own_units:
                caller = session.caller(unit)._replace(auditor=self.auditor)
                return self._own.answer(pdu, caller) or None
            if unit or not self.lines:
                return self._refuse_route(session, pdu)
        try:
            request = request_of(pdu)
        except ExceptionResponse as refusal:
            self.statistics.malformed += 1
            return _exception(pdu, refusal.code)
        auditor = self.auditor
        is_refused = False
        try:
            if auditor is not None and request.changes and not auditor.may_change():
                response: bytes | None = _exception(pdu, errors.ServerDeviceFailure.code)
            elif way is None:
                response = self._broadcast(session, frame, request)
            else:
                response = self._forward(session, frame, request, way)
        except NotAllowed as refusal:
            # The code does not tell: devices and hooks of `authorize` use the same ones.
            is_refused, response = True, _exception(pdu, refusal.code)
        if response is not None and (request.changes or is_refused):
            session.record(unit, request, response, is_change=request.changes)
        return response

    def _forward(
        self, session: ForwardingSession, frame: Frame, request: RequestBytes, way: ResolvedRoute
    ) -> bytes | None:
        unit, pdu, number = frame
        line, device_unit, route = way
        self._check(session, unit, request, route.allow)
        now = self.now()
        age = route.cache if request.is_read else 0.0
        if age and (answer := line.cached_response(device_unit, request, age, now)):
            return answer
        if len(session.open_requests) >= self._most_of_session:
            line.statistics.full += 1
            return self._refuse_more(session, pdu)
        job = ForwardedRequest(session, number, unit, device_unit, request, now, age)
        session.open_requests[job] = line
        code = line.put(job, merge=route.merge and request.is_read)
        if not code:
            return None
        session.open_requests.pop(job, None)
        if code == errors.ServerDeviceBusy.code:
            return self._refuse_more(session, pdu)
        return _exception(pdu, code)

    def _refuse_more(self, session: ForwardingSession, pdu: bytes) -> bytes:
        self._log.warning("%s: exception 6: too many of its requests wait (queue)", session.peer)
        return _exception(pdu, errors.ServerDeviceBusy.code)

    def _refuse_route(self, session: ForwardingSession, pdu: bytes) -> bytes | None:
        """Refuse a unit without a route, except on a serial line, where the unit may be itself."""
        self.statistics.no_route += 1
        return None if session.is_line else _exception(pdu, errors.GatewayPathUnavailable.code)

    def _check(
        self, session: ForwardingSession, unit: int, request: RequestBytes, allow: Allow | None
    ) -> None:
        """Raise NotAllowed if `authorize` or the rules of a route refuse a request."""
        if self._guard is None and allow is None:
            return
        who: Who = unit, session.peer, session.role
        pdu_request, accesses = request.pdu_request, touched(request.pdu_request, who)
        action = ClientRequest(
            session.role, unit, session.peer, request.function, pdu_request, *accesses
        )
        try:
            if self._guard is not None:
                self._guard.check(action)
        except UnauthorizedError as refusal:
            session.statistics.unauthorized += 1
            self.statistics.refused += 1
            raise NotAllowed(refusal.code) from None
        except ExceptionResponse as refusal:
            raise NotAllowed(refusal.code) from None
        except (SystemExit, KeyboardInterrupt):
            raise
        except BaseException:
            if not self._has_failed:  # once: a client must not be able to fill the log
                self._has_failed = True
                logger.exception("authorize failed; answered with exception 4")
            raise NotAllowed(errors.ServerDeviceFailure.code) from None
        # A request that cannot be decoded may access anything.
        if allow is not None and (pdu_request is None or not allow.allows(action)):
            self.statistics.refused += 1
            message = "%s: the route forwards no %s (read_only, writable)"
            self._log.warning(message, session.peer, authorization.what_is_asked(action))
            raise NotAllowed(errors.IllegalFunction.code)

    def _broadcast(
        self, session: ForwardingSession, frame: Frame, request: RequestBytes
    ) -> bytes | None:
        """
        Send a write to all lines, if the rules of all routes allow it.

        Other requests are refused, because they would get no response. A write is refused while an
        equal one of another client is sent, and for a second after it, because it may be the same
        one: gateways that lead to each other would send it round for ever.
        """
        ways = self.routes.values()
        lines = [line for line in {way.line: None for way in ways} if not session.is_at(line)]
        if not request.may_be_broadcast or not lines:
            return self._refuse_route(session, frame.pdu)
        # A unit of each route would carry it out. `Allow` has no hash.
        for allow in {id(way.route.allow): way.route.allow for way in ways}.values():
            self._check(session, 0, request, allow)
        now, former = self.now(), self._broadcasts
        while former and next(iter(former.values())).done_at + RETURN_S <= now:
            del former[next(iter(former))]
        before = former.get(request.pdu)
        if before is not None and not before.session.is_same_client(session):
            return _exception(frame.pdu, errors.ServerDeviceBusy.code)
        former.pop(request.pdu, None)  # so that the latest one is the last one
        self.statistics.broadcasts += 1
        former[request.pdu] = Broadcast(session, frame, request, lines, self.now)
        former[request.pdu].begin()
        return None


class NotAllowed(Exception):
    """`authorize`, or the rules of a route, refuse a request with the exception `code`."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code: int = code


def _exception(pdu: bytes, code: int) -> bytes:
    return bytes([pdu[0] | 0x80, code])


class Broadcast:
    """A write to all units of all lines; `done_at` is infinite until all lines have sent it."""

    def __init__(
        self,
        session: ForwardingSession,
        frame: Frame,
        request: RequestBytes,
        lines: list[GatewayLine],
        now: Callable[[], float],
    ) -> None:
        self.host: Hashable = session.host
        self.session: ForwardingSession = session
        self.done_at: float = math.inf
        self._now = now
        self._whole = ForwardedRequest(session, frame.transaction, 0, 0, request, now())
        self._parts = {ForwardedRequest(self, 0, 0, 0, request, now()): line for line in lines}
        self._left = len(lines)
        self._has_failed = False

    def begin(self) -> None:
        self.session.open_requests[self._whole] = self
        for part, line in self._parts.items():
            if line.put(part):
                self.take_response(part, b"\x80")

    def leave(self, job: ForwardedRequest) -> None:
        """Take no response; and send no more, if the client waited for it to be sent."""
        job.requester = None
        if self.session.has_ids:
            for part, line in self._parts.items():
                line.leave(part)
            self.done_at = self._now()

    def take_response(self, job: ForwardedRequest, response: bytes | None) -> None:
        self._left -= 1
        self._has_failed = self._has_failed or (response is not None and response[0] >= 0x80)
        if self._left:
            return
        self.done_at = self._now()
        refusal = _exception(self._whole.request.pdu, errors.GatewayTargetFailedToRespond.code)
        self._whole.answer(refusal if self._has_failed and self.session.has_ids else None)


# --- sessions ---------------------------------------------------------------------------------


class ForwardingSession(FrameServer):
    """
    The requests of one client that wait for their responses, with what they leave.

    Over TCP and UDP a broadcast gets the response to the write once it was sent, because clients
    there do not know broadcasts and would wait.

    A client without transaction ids that sends another request has given up the earlier one: the
    earlier response is dropped, because the client would take it for the response to the new one.
    """

    def __init__(self, dispatcher: Dispatcher, settings: SessionSettings, channel: Channel) -> None:
        endpoint = settings.endpoint
        is_ours = dispatcher.has_unit if endpoint.is_serial else lambda unit: True
        super().__init__(settings, channel, is_ours)
        self.peer: str = channel.address
        self.role: str | None = channel.role
        self.host: Hashable = host_of(channel.address)
        self._peer_host = host_of_peer(channel.address)
        self.has_ids: bool = endpoint.has_transactions
        self.is_line: bool = endpoint.is_serial
        self._dispatcher = dispatcher
        self.open_requests: dict[ForwardedRequest, GatewayLine | Broadcast] = {}
        self._unanswered = self.open_requests

    def caller(self, unit: int) -> Caller:
        return Caller(unit, self.peer, role=self.role, holder=self.channel.holder)

    def is_at(self, line: GatewayLine) -> bool:
        """
        Return True if a line leads to the machine of this client, such as another gateway, which
        would send a broadcast back for ever. On this machine nothing tells clients from devices.
        """
        return line.endpoint.host == self._peer_host and not is_loopback(self._peer_host)

    def is_same_client(self, other: ForwardingSession) -> bool:
        """Return True for itself, and for another datagram of the same address."""
        is_datagram = self._settings.endpoint.is_datagram
        return self is other or (is_datagram and self.peer == other.peer)

    def record(
        self, unit: int, request: RequestBytes, response: bytes, *, is_change: bool = True
    ) -> None:
        """Record a request and its response, if there is an audit trail."""
        if (auditor := self._dispatcher.auditor) is not None:
            caller = self.caller(unit)._replace(is_broadcast=unit == 0)
            changes = changes_of(request.pdu_request, caller)
            auditor.note(ExecutedRequest(caller, request.pdu, response, changes, is_change))

    def take_response(self, job: ForwardedRequest, response: bytes | None) -> None:
        self.open_requests.pop(job, None)
        request = job.request
        if request.changes:
            self.record(job.from_unit, request, response or b"")
        if response is None and self.has_ids and request.may_be_broadcast:
            assert request.pdu_request is not None
            response = request.pdu_request.encode_response(None)
        if response is not None:
            answer = Frame(job.from_unit, response, job.number)
            self._send(answer, self.framer.encode(answer))
        if not self.open_requests and self._settings.endpoint.is_datagram:
            self.channel.follow()

    def answer(self, request: Frame) -> Frame | None:
        if not self.has_ids:
            self._withdraw(list(self.open_requests))
        response = self._dispatcher.ask(self, request)
        return None if response is None else request._replace(pdu=response)

    def close(self) -> None:
        super().close()
        self._withdraw(list(self.open_requests))

    def _withdraw(self, given_up: list[ForwardedRequest]) -> None:
        for job in given_up:
            place = self.open_requests.pop(job)
            if job.request.changes:
                self.record(job.from_unit, job.request, b"")
            place.leave(job)
