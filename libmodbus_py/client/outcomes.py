"""
The outcome of each request that failed: a repetition, or an error with the likely mistake.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..ports.schemes import SCHEMES, TRANSPORTS
from ..protocol.errors import (
    Acknowledge,
    ExceptionResponse,
    IllegalDataAddress,
    IllegalFunction,
    InvalidResponse,
    ModbusError,
    ServerDeviceBusy,
    alike,
)
from ..protocol.framing import crc16, is_one_frame
from ..protocol.mistakes import explain_reference
from .call import Call
from .queue import Queue
from .reconnecting import Reconnecting
from .statistics import Statistics, result_of

if TYPE_CHECKING:
    from ..ports.endpoint import Endpoint
    from ..ports.port import Port
    from ..protocol.framing import Framing

__all__ = ["CLOSED", "Outcomes", "add_hint", "explain", "explain_end"]

CLOSED = (errno.ECONNRESET, errno.EPIPE)
"""Errno if the other side has closed the connection."""

BUSY = (Acknowledge, ServerDeviceBusy)

PLAIN = tuple(scheme for scheme, (_, transport) in SCHEMES.items() if transport == "tcp")
"""The schemes of connections without TLS."""

ASCII_FRAME = rb":[0-9A-Fa-f]{6}"


class Outcomes:
    """Decides about requests without a result; the endpoint and the port are for errors."""

    def __init__(
        self, endpoint: Endpoint, port: Port, queue: Queue, life: Reconnecting, counts: Statistics
    ) -> None:
        self._place = str(endpoint)
        self._scheme = endpoint.scheme
        self._port = port
        self._queue = queue
        self._matching = queue.matching
        self._life = life
        self._statistics = counts

    def note_invalid(self, mistake: BaseException, call: Call, now: float) -> None:
        """Note an exception of a request class for a reply: an invalid reply, or a mistake."""
        if isinstance(mistake, ModbusError):
            assert isinstance(call.reply, bytes)
            self._statistics.invalid += isinstance(mistake, InvalidResponse)
            mistake.received = self._matching.received_with(call, call.reply)
            self.fail(mistake, call, now)
        else:
            self._statistics.note(call.function, "invalid")
            call.settle(mistake)

    def fail_unsent(self, call: Call, error: ModbusError) -> None:
        """Fail a request that is not sent."""
        self._queue.note_end(call)
        if call.request is not None:
            self._statistics.note(call.function, "unsent")
        call.settle(self._outcome(alike(error), call))

    def refuse(self, call: Call, error: ModbusError) -> None:
        """Fail a request that is not sent, or not again; and later ones of its caller."""
        follower: Call | None = call
        while follower is not None:
            self.fail_unsent(follower, error)
            batch = follower.batch
            follower = batch.next() if batch is not None and batch.waiting else None

    def _outcome(self, error: ModbusError, call: Call) -> BaseException:
        """Return an error with its request, or the exception that the request's class raised."""
        error.unit, error.endpoint, error.sent = call.unit, self._place, call.adu
        try:
            if call.request is not None:
                error.function, error.asked = call.request.function, str(call.request)
            is_answer = isinstance(error, InvalidResponse | ExceptionResponse)
            if error.received and call.adu and not is_answer:
                add_hint(error, explain(self._scheme, call.adu, error.received))
            if isinstance(error, IllegalDataAddress):
                add_hint(error, _explain_address(call))
            if isinstance(error, IllegalFunction):
                add_hint(error, _explain_role(self._port.certificate))
        except BaseException as mistake:
            return mistake
        return error

    def fail(self, error: ModbusError, call: Call, now: float) -> None:
        """Set the outcome of a request that failed, or send it again."""
        if isinstance(error, ExceptionResponse):
            self._statistics.exceptions += 1
            self._statistics.note_answer(call.pdu[0], now - call.sent_at, now, "exception")
            self._life.prove()
        else:
            self._statistics.note(call.function, result_of(error))
        self._matching.conclude(call, error, now)
        try:
            if not self._is_repeated(error, call, now):
                call.settle(self._outcome(error, call))
        except BaseException as mistake:  # of the class of the request
            call.settle(mistake)

    def _is_repeated(self, error: ModbusError, call: Call, now: float) -> bool:
        """Send a request again later, if that is allowed; return False if not."""
        is_busy = isinstance(error, BUSY)
        assert call.request is not None
        if not is_busy and (isinstance(error, ExceptionResponse) or not call.request.repeatable):
            return False
        tries = call.try_again(now, is_busy=is_busy)
        if tries is None:
            return False
        # A busy device is asked again after 0.1 seconds, doubled each time, up to 1 second.
        pause = min(1.0, 0.1 * 2**tries) if is_busy else 0.0
        self._queue.put_again(call, now + pause)
        return True


# --- likely mistakes ---------------------------------------------------------------------------


def add_hint(error: ModbusError, hint: str) -> None:
    """Append a hint, unless it is empty, to the message of an error."""
    error.args = (f"{error.args[0]}; {hint}",) if hint else error.args


def explain(scheme: str, request: bytes, data: bytes) -> str:
    """Return the likely mistake if such bytes, which are no answer, come; "" if there is none."""
    framing, transport = SCHEMES[scheme]  # type: ignore[index]
    # The header of a TLS record (RFC 8446, 5.1).
    if scheme in PLAIN and re.match(rb"[\x14-\x17]\x03[\x00-\x04]..", data, re.DOTALL):
        return "this looks like tls://"
    if framing in ("rtu", "ascii") and data.startswith(request):
        return "the request itself came back; echo=True?"
    others = {SCHEMES[other][0]: other for other in SCHEMES if SCHEMES[other][1] == transport}
    for looks_so, framings in _LOOKS.items():
        if framing not in framings and looks_so(data):
            names = [others[name] for name in framings if name in others] or framings
            return f"this looks like {names[0]}://"
    if TRANSPORTS[transport].is_listening:
        return "a registration packet or heartbeat? see greeting"
    unit, function = request[0], request[1]
    starts = (bytes([unit, function]), bytes([unit, function | 0x80]))
    if scheme == "rtu" and not any(start in data for start in starts):
        return "only noise; baud rate, parity, A and B swapped?"
    return ""


def explain_end(scheme: str, number: int | None) -> str:
    """Return the likely mistake if a connection ended, with this errno, before any answer."""
    is_plain = scheme in PLAIN and number in CLOSED
    return "nothing was answered yet; does it want tls://?" if is_plain else ""


def _explain_address(call: Call) -> str:
    """Return which address is meant if that of a single request looks like a reference."""
    if call.batch is not None:
        return ""
    return explain_reference(getattr(call.request, "address", None), call.function)


def _explain_role(certificate: bytes | None) -> str:
    """Return why a server may refuse a function: the role in the client's certificate (DER)."""
    if certificate is None:
        return ""
    try:
        from ..security.certificates import role_of

        role = role_of(certificate)
    # Without cryptography, or a descriptor to import it; or the SSLContext was given.
    except (ImportError, OSError, ValueError):
        return "the server may allow it to other roles only"
    if role is None:
        return "the server may allow it to some roles only, and this certificate has none"
    return f"the server may allow it to other roles than {role!r}"


def _looks_ascii(data: bytes) -> bool:
    return re.search(ASCII_FRAME, data) is not None


def _looks_rtu(data: bytes) -> bool:
    return any(crc16(data[:end]) == 0 for end in range(5, min(len(data), 256) + 1))


_LOOKS: dict[Callable[[bytes], bool], tuple[Framing, ...]] = {
    _looks_ascii: ("ascii",),
    is_one_frame: ("tcp", "udp"),
    _looks_rtu: ("rtu",),
}
