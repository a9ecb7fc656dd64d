"""
The server of a program: devices, and faults in their responses: which fault is due for a request,
the bytes that it makes, and when they are sent.
"""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from ...device.access import touched_by
from ...device.device import Device
from ...ports.trace import OnTraced
from ...protocol.checks import integer
from ...protocol.framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer
from ...protocol.mistakes import named_arguments
from ...server.limits import Limits
from ...server.service import Intercepted
from ...server.serving import DeviceServer
from ...server.units import UnknownUnit
from .fault import Fault, FaultsByUnit, FaultSwitch

__all__ = ["Faults", "Server"]

MAX_WAITING_BYTES = 1 << 17
"""On a connection, fewer bytes wait: the answers to one read. On a serial line this limits the
answers to a client that does not wait for them."""


class _Counted:
    """A fault, and its count of requests."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self._count = 0
        self._random = random.Random(fault.seed)

    def is_due(self) -> bool:
        if self.fault.probability is not None:
            return self._random.random() < self.fault.probability
        self._count += 1
        return self._count % (self.fault.every or 1) == 0

    def happening(self) -> Fault:
        """The fault as it happens this time: with its random bytes."""
        fault = self.fault
        if not fault.has_random_bytes:
            return fault
        data = self._random.randbytes(fault.length or 0)
        return replace(fault, data=data, length=None, seed=None)


class Faults:
    """The faults of a server by unit or alias; those equal to faults of `before` go on counting."""

    def __init__(
        self,
        faults: Mapping[int | None, Iterable[Fault]],
        before: Faults | None = None,
        aliases: Mapping[int, int] | None = None,
    ) -> None:
        self._by_unit: dict[int | None, list[_Counted]] = {}
        for unit, given_faults in faults.items():
            key = None if unit is None else integer("faults: unit", unit, 0, 255)
            known = [] if before is None else list(before._by_unit.get(key, ()))
            self._by_unit[key] = [_counted(fault, known) for fault in given_faults]
        for alias, unit in (aliases or {}).items():
            if unit in self._by_unit:
                self._by_unit.setdefault(alias, self._by_unit[unit])

    def __bool__(self) -> bool:
        return any(self._by_unit.values())

    def concerns(self, unit: int) -> bool:
        return bool(self._by_unit.get(unit) or self._by_unit.get(None))

    def intercept(self, session: Intercepted) -> FaultyAnswers:
        return FaultyAnswers(session)

    def due(self, request: Frame, *, has_transaction: bool) -> Fault | None:
        """Count a request that is going to be answered, and return its fault, or None."""
        due = [
            each
            for each in (*self._by_unit.get(request.unit, ()), *self._by_unit.get(None, ()))
            if _concerns(each.fault, request, has_transaction) and each.is_due()
        ]
        return due[0].happening() if due else None


def _concerns(fault: Fault, request: Frame, has_transaction: bool) -> bool:
    if fault.function not in (None, request.pdu[0]):
        return False
    if fault.kind == "wrong_transaction" and not has_transaction:
        return False
    return fault.is_everywhere or fault.hits(touched_by(request.pdu))


def _counted(fault: object, known: list[_Counted]) -> _Counted:
    """Return the known counter of an equal fault, each once, or a new one."""
    if not isinstance(fault, Fault):
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {fault!r}")
    for at, each in enumerate(known):
        if each.fault == fault:
            return known.pop(at)
    return _Counted(fault)


class Fragment(NamedTuple):
    """Bytes to send, and the seconds to wait after the previous fragment."""

    wait: float
    data: bytes
    is_last: bool = False  # the connection is closed behind it
    traced: tuple[tuple[bytes, Frame | None], ...] = ()  # None for bytes that are no frame


def fragments(fault: Fault | None, answer: Frame, framer: Framer) -> list[Fragment]:
    """Return what is sent in place of an answer."""
    kind = "" if fault is None else fault.kind
    if kind == "no_answer":
        return []
    if kind == "wrong_transaction":
        # Never that of the next request, because this would then count as its answer.
        answer = answer._replace(transaction=answer.transaction - 1 & 0xFFFF)
    if kind == "wrong_unit":
        answer = answer._replace(unit=answer.unit % 247 + 1)  # one that a serial line can have
    adu = framer.encode(answer)
    parts = (adu,) if fault is None else _parts(fault, adu, framer)
    traced = tuple((each, answer if each == adu else None) for each in parts if each)
    data = b"".join(parts)
    wait = 0 if fault is None else fault.seconds or 0
    if kind != "trickle":
        return [Fragment(wait, data, kind == "disconnect", traced)]
    found = [Fragment(wait if at else 0, data[at : at + 1]) for at in range(len(data))]
    return [*found[:-1], found[-1]._replace(traced=traced)]


def _parts(fault: Fault, adu: bytes, framer: Framer) -> tuple[bytes, ...]:
    """Return the bytes sent in place of a frame; the frame is a part of its own."""
    garbage = fault.data or b""
    match fault.kind:
        case "wrong_check":
            return (_with_wrong_check(adu, framer),)
        case "truncate":
            return (adu[: min(fault.length or 0, len(adu) - 1)],)
        case "disconnect":
            return (adu[: fault.length or 0],)
        case "garbage" if fault.place == "instead":
            return (garbage,)
        case "garbage" if fault.place == "behind":
            return (adu, garbage)
        case "garbage":
            return (garbage, adu)
    return (adu,)


def _with_wrong_check(adu: bytes, framer: Framer) -> bytes:
    if isinstance(framer, RtuFramer):
        return adu[:-2] + bytes(byte ^ 0xFF for byte in adu[-2:])
    if isinstance(framer, AsciiFramer):  # two digits before CR and delimiter
        return adu[:-4] + b"%02X" % (int(adu[-4:-2], 16) ^ 0xFF) + adu[-2:]
    return adu[:4] + b"\0\0" + adu[6:]  # the length in the header


class FaultyAnswers:
    """The answers of one session: in order, late, wrong, in fragments or not at all."""

    def __init__(self, session: Intercepted) -> None:
        self.is_waiting: bool = False
        self.is_over: bool = False
        self._session = session
        self._queue: deque[Fragment] = deque()
        self._queued = 0  # bytes
        self._timer: asyncio.TimerHandle | None = None

    def answer(self, request: Frame) -> None:
        """Execute a request, and deliver its answer as the fault that is due makes it."""
        session, fault = self._session, None
        faults = session.interceptor
        if isinstance(faults, Faults) and session.is_answered(request):
            has_transaction = isinstance(session.framer, TcpFramer)
            fault = faults.due(request, has_transaction=has_transaction)
        answer = session.answer(request, 0 if fault is None else fault.code or 0)
        if answer is not None:
            session.statistics.refused += answer.pdu[0] >> 7
            self.send(fragments(fault, answer, session.framer))

    def send(self, answer: list[Fragment]) -> None:
        """Send an answer after the previous ones; it is dropped if too much waits already."""
        if self._queued >= MAX_WAITING_BYTES or self.is_over:
            return
        self._queue += answer
        self._queued += sum(len(fragment.data) for fragment in answer)
        if self._timer is None:
            self._go_on()

    def close(self) -> None:
        """Drop all fragments that were not sent."""
        self._queue.clear()
        self._queued = 0
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _go_on(self) -> None:
        """Send the fragments that are due, then wait for the next."""
        while self._queue:
            if self._queue[0].wait:
                loop = asyncio.get_running_loop()
                self._timer = loop.call_later(self._queue[0].wait, self._send_next)
                break
            self._send_first()
        if self.is_waiting != bool(self._queue):
            self.is_waiting = not self.is_waiting
            self._session.channel.follow()

    def _send_next(self) -> None:
        self._timer = None
        self._send_first()
        self._go_on()

    def _send_first(self) -> None:
        fragment, session = self._queue.popleft(), self._session
        self._queued -= len(fragment.data)
        if session.trace is not None:
            for adu, frame in fragment.traced:
                facts = () if frame is None else (frame.unit, frame.pdu[0])
                session.trace.tell("sent", adu, *facts)
        if fragment.data or not fragment.is_last:
            session.write(fragment.data)
        if fragment.is_last and session.channel.hang_up():
            self.is_over = True
            self.close()


if TYPE_CHECKING:
    from ...security.security import Security
    from ...server.audit import Audit, OnAudited


@named_arguments
class Server(DeviceServer):
    """
    A server that answers the requests of any number of clients from devices.

    On serial lines, and with RTU or ASCII frames over TCP, a request to a unit without a device
    gets no response, and unit 0 is a broadcast: every device executes writes, and none responds.

    Args:
        devices: ``{unit 0..255: device}``, or one device that answers every unit.
        faults: ``{unit 0..255: faults}``, faults in the responses of a unit;
            None as the unit is every unit.
        limits: limits of connections and requests; None for the defaults of `Limits`.
        unknown_unit: what a request to a unit without a device gets on TCP and UDP: "refuse",
            exception 11; "silent", no response.
        own_unit: the unit whose device represents the server itself: on TCP and UDP, it also
            answers units 0 and 255, unless they have devices of their own. A single device
            always does. None for no such unit.
        security: the certificates of the server and of trusted clients, for tls; URLs may contain
            them instead.
        trace: called in the server's loop with a `Traced` for every ADU received and sent; the
            logger ``libmodbus_py.wire`` gets the same at DEBUG. Whether tracing is on is
            checked when a connection is made, or a port opened. If the function fails or takes
            long, this is logged once, and requests are not affected; SystemExit and
            KeyboardInterrupt end the server.
        audit: called with an `AuditEvent` for each write, and for each request and connection
            that is refused; an `Audit` can refuse writes while the function fails. With it,
            Modbus/TCP is not answered in C.

    Attributes:
        statistics: counters of all endpoints, kept up to date.
        devices, faults: as passed, or as set by `replace`.
        fault_switch: switches more faults on and off while the server runs; shared by all its
            users.

    Raises:
        TypeError, ValueError: an argument is wrong.
    """

    def __init__(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
        limits: Limits | None = None,
        unknown_unit: UnknownUnit = "refuse",
        own_unit: int | None = None,
        security: Security | None = None,
        trace: OnTraced | None = None,
        audit: Audit | OnAudited | None = None,
    ) -> None:
        super().__init__(limits, unknown_unit, own_unit, security, trace, audit)
        self._counted: Faults | None = None
        self.fault_switch: FaultSwitch = FaultSwitch(
            lambda faults: self._serve(self.devices, faults)
        )
        self.replace(devices, faults)

    def replace(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None = None,
    ) -> None:
        """
        Replace devices and faults. May be called from any thread, even while the server runs.

        Connections stay open. If it is called in the server's loop, the change applies from the
        next request on; if it is called from another thread, once the requests already read are
        answered. Responses that a fault delays are still sent. `own_unit` and all other arguments
        stay as they are. Faults that are equal to previous ones go on counting, the counters and
        the event log of a serial line (functions 8, 11 and 12) stay with their unit, and faults
        that `fault_switch` has switched on stay on.

        Args:
            devices, faults: as for `Server`; None for no faults.

        Raises:
            TypeError, ValueError: as for `Server`; nothing has changed.
        """
        if faults is not None and not isinstance(faults, Mapping):
            given_type = type(faults).__name__
            raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {given_type}")
        given = {unit: list(each) for unit, each in (faults or {}).items()}
        with self.fault_switch.giving(given) as faults_on:
            self._serve(devices, faults_on)
        self.faults: Mapping[int | None, list[Fault]] = given

    def _serve(self, devices: Device | Mapping[int, Device], faults: FaultsByUnit) -> None:
        units = self.units_of(devices)
        self._counted = Faults(faults, self._counted, units.aliases)
        units.interceptor = self._counted or None
        self.devices: Device | Mapping[int, Device] = devices
        self.serve_units(units)
