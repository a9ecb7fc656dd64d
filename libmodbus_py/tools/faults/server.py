"""
The server of a program: devices, and faults in their responses: which fault is due for a request,
the bytes that it makes, and when they are sent.
"""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from ...device.access import Touched, touched_by
from ...device.device import Device
from ...ports.trace import OnTraced, Trace
from ...protocol.checks import integer
from ...protocol.framing import AsciiFramer, Frame, Framer, RtuFramer, TcpFramer
from ...protocol.mistakes import named_arguments
from ...server.limits import Limits
from ...server.service import Channel, Intercepted
from ...server.serving import DeviceServer
from ...server.units import UnknownUnit
from .fault import Fault, FaultsByUnit, FaultSwitch

__all__ = ["MAX_WAITING_BYTES", "Delivery", "Faults", "Fragment", "Server", "fragments"]

MAX_WAITING_BYTES = 1 << 17
"""On a connection, fewer bytes wait: the answers to one read. On a serial line this limits the
answers to a client that does not wait for them."""

NO_ALIASES: dict[int, int] = {}

# --- which fault is due ----------------------------------------------------------------------


class _Counted:
    """A fault, and its count of requests."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self._every = fault.every or 1
        self._count = 0
        self._random = random.Random(fault.seed)

    def is_due(self) -> bool:
        if self.fault.probability is not None:
            return self._random.random() < self.fault.probability
        self._count += 1
        return self._count % self._every == 0

    def happening(self) -> Fault:
        """The fault as it happens this time: with its random bytes."""
        fault = self.fault
        if fault.kind != "garbage" or fault.length is None:
            return fault
        return replace(fault, data=self._random.randbytes(fault.length), length=None, seed=None)


class Faults:
    """
    The faults of one server. See `Interceptor`.

    Args:
        faults: ``{unit 0..255: faults}``; None is every unit.
        before: the previous faults of the same server: equal ones go on counting.
        aliases: further units, and the unit whose faults they have if they have none of their own.

    Raises:
        TypeError, ValueError: a unit or a fault is wrong.
    """

    def __init__(
        self,
        faults: Mapping[int | None, Iterable[Fault]],
        before: Faults | None = None,
        aliases: Mapping[int, int] = NO_ALIASES,
    ) -> None:
        self._by_unit: dict[int | None, list[_Counted]] = {}
        for unit, given_faults in faults.items():
            key = None if unit is None else integer("faults: unit", unit, 0, 255)
            known = [] if before is None else list(before._by_unit.get(key, ()))
            self._by_unit[key] = [_counted(fault, known) for fault in given_faults]
        for alias, unit in aliases.items():
            if unit in self._by_unit:
                self._by_unit.setdefault(alias, self._by_unit[unit])

    def __bool__(self) -> bool:
        return any(self._by_unit.values())

    def concerns(self, unit: int) -> bool:
        """Return True if the answers of a unit have faults."""
        return bool(self._by_unit.get(unit) or self._by_unit.get(None))

    def intercept(self, session: Intercepted) -> FaultyAnswers:
        return FaultyAnswers(session)

    def due(self, request: Frame, *, has_transaction: bool) -> Fault | None:
        """
        Count a request that is going to be answered.

        Args:
            request: the request as it was received.
            has_transaction: True if frames of its line have transactions.

        Returns:
            The fault that happens to the request, or None.
        """
        touched: Touched | None = None
        first: _Counted | None = None
        for key in (request.unit, None):
            for each in self._by_unit.get(key, ()):
                fault = each.fault
                if fault.function not in (None, request.pdu[0]):
                    continue
                if fault.kind == "wrong_transaction" and not has_transaction:
                    continue
                if not fault.is_everywhere:
                    touched = touched or touched_by(request.pdu)
                    if not fault.hits(touched):
                        continue
                if each.is_due() and first is None:
                    first = each
        return None if first is None else first.happening()


def _counted(fault: object, known: list[_Counted]) -> _Counted:
    """Return the known counter of an equal fault, each once, or a new one."""
    if not isinstance(fault, Fault):
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {fault!r}")
    for at, each in enumerate(known):
        if each.fault == fault:
            return known.pop(at)
    return _Counted(fault)


# --- its bytes -------------------------------------------------------------------------------


class Fragment(NamedTuple):
    """
    Bytes to send, and the seconds to wait after the previous fragment.

    Attributes:
        is_last: True if the connection is closed behind them.
        traced: what a trace gets when they are sent: bytes, and their frame, None if they are
            not a frame.
    """

    wait: float
    data: bytes
    is_last: bool = False
    traced: tuple[tuple[bytes, Frame | None], ...] = ()


def fragments(fault: Fault | None, answer: Frame, framer: Framer) -> list[Fragment]:
    """Return the fragments sent in place of an answer; for garbage `data` is required."""
    kind = "" if fault is None else fault.kind
    frame = _changed(kind, answer)
    adu = framer.encode(frame)
    parts = (adu,) if fault is None else _parts(fault, adu, framer)
    data = b"".join(parts)
    wait = 0 if fault is None else fault.seconds or 0
    if kind == "no_answer":
        made = []
    elif kind == "trickle":
        made = [Fragment(wait if at else 0, data[at : at + 1]) for at in range(len(data))]
    else:
        made = [Fragment(wait, data, kind == "disconnect")]
    traced = tuple((each, frame if each == adu else None) for each in parts if each)
    return [*made[:-1], *(each._replace(traced=traced) for each in made[-1:])]


def _changed(kind: str, answer: Frame) -> Frame:
    if kind == "wrong_transaction":
        # Never that of the next request, because this would then count as its answer.
        return answer._replace(transaction=answer.transaction - 1 & 0xFFFF)
    if kind == "wrong_unit":
        return answer._replace(unit=answer.unit % 247 + 1)  # one that a serial line can have
    return answer


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


# --- when they are sent ----------------------------------------------------------------------


class Delivery:
    """
    Sends bytes to one client, in order, each at its time. For one loop only.

    Args:
        channel: channel of the client; `follow` is called whenever `is_waiting` has changed.
        trace: called with all that is sent, or None.
        write: sends bytes; by default the channel's.

    Attributes:
        is_waiting: True while something is to be sent later.
        is_over: True once the connection was closed; nothing more is sent.
    """

    def __init__(
        self,
        channel: Channel,
        trace: Trace | None = None,
        write: Callable[[bytes], None] | None = None,
    ) -> None:
        self.is_waiting: bool = False
        self.is_over: bool = False
        self._channel = channel
        self._trace = trace
        self._write = write or channel.write
        self._loop = asyncio.get_running_loop()
        self._queue: deque[Fragment] = deque()
        self._queued = 0
        self._timer: asyncio.TimerHandle | None = None

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
                self._timer = self._loop.call_later(self._queue[0].wait, self._send_next)
                break
            self._send_first()
        if self.is_waiting != bool(self._queue):
            self.is_waiting = not self.is_waiting
            self._channel.follow()

    def _send_next(self) -> None:
        self._timer = None
        self._send_first()
        self._go_on()

    def _send_first(self) -> None:
        fragment = self._queue.popleft()
        self._queued -= len(fragment.data)
        if self._trace is not None:
            for adu, frame in fragment.traced:
                facts = () if frame is None else (frame.unit, frame.pdu[0])
                self._trace.tell("sent", adu, *facts)
        if fragment.data or not fragment.is_last:
            self._write(fragment.data)
        if fragment.is_last and self._channel.hang_up():
            self.is_over = True
            self.close()


class FaultyAnswers:
    """The answers of one session: late, wrong, in fragments or not at all. See `Interception`."""

    def __init__(self, session: Intercepted) -> None:
        self._session = session
        self._delivery = Delivery(session.channel, session.trace, session.write)
        self._has_transaction = isinstance(session.framer, TcpFramer)

    @property
    def is_waiting(self) -> bool:
        return self._delivery.is_waiting

    @property
    def is_over(self) -> bool:
        return self._delivery.is_over

    def answer(self, request: Frame) -> None:
        """Execute a request, and deliver its answer as the fault that is due makes it."""
        session, fault = self._session, None
        faults = session.interceptor
        if isinstance(faults, Faults) and session.is_answered(request):
            fault = faults.due(request, has_transaction=self._has_transaction)
        answer = session.answer(request, 0 if fault is None else fault.code or 0)
        if answer is not None:
            session.statistics.refused += answer.pdu[0] >> 7
            self._delivery.send(fragments(fault, answer, session.framer))

    def close(self) -> None:
        self._delivery.close()


# --- the server -----------------------------------------------------------------------------------


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
        self.fault_switch: FaultSwitch = FaultSwitch(self._change_faults)
        self._put(devices, faults)

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
        self._put(devices, faults)

    def _put(
        self,
        devices: Device | Mapping[int, Device],
        faults: Mapping[int | None, Iterable[Fault]] | None,
    ) -> None:
        given = {unit: list(each) for unit, each in _listed(faults).items()}
        with self.fault_switch.giving(given) as switched_on:
            self._serve(devices, switched_on)
        self.faults: Mapping[int | None, list[Fault]] = given

    def _change_faults(self, faults: FaultsByUnit) -> None:
        self._serve(self.devices, faults)

    def _serve(self, devices: Device | Mapping[int, Device], faults: FaultsByUnit) -> None:
        units = self.units_of(devices)
        self._counted = Faults(faults, self._counted, units.aliases)
        units.interceptor = self._counted or None
        self.devices: Device | Mapping[int, Device] = devices
        self.serve_units(units)


def _listed(faults: object) -> Mapping[int | None, Iterable[Fault]]:
    if faults is None:
        return {}
    if not isinstance(faults, Mapping):
        given = type(faults).__name__
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {given}")
    return faults
