"""
One question to one unit, and what its answer says.

The probe is function 3, one register at address 0: the function that most devices have, and
those that lack function or register answer with an exception, which is an answer (application
protocol, section 7). Nothing changes in a device by it, and an echo of it is no answer to it.
"""

from __future__ import annotations

import errno
from typing import Any, NamedTuple

from ...client.blocking import Context
from ...ports.trace import Traced
from ...ports.waiting import Waker
from ...protocol import pdu
from ...protocol.errors import (
    NO_UNIT,
    ExceptionResponse,
    FrameError,
    ModbusConnectionError,
    ModbusError,
)
from ...protocol.pdu import DeviceIdentification, ServerId
from ...protocol.pdu.interface import identify
from ..listener.traces import TracePairing
from ..listener.transaction import Transaction
from .places import Place

# fmt: off
__all__ = [
    "LONGEST_SIZE", "MOST_PAGES", "PROBE", "PROBE_SIZE", "Answer", "Late", "Nothing", "Prober",
    "Reading",
]
# fmt: on

# All that ever leaves: nothing that writes has a place here.
Reading = (
    pdu.ReadCoils
    | pdu.ReadDiscreteInputs
    | pdu.ReadHoldingRegisters
    | pdu.ReadInputRegisters
    | pdu.ReportServerId
    | pdu.ReadDeviceIdentification
)

PROBE = pdu.ReadHoldingRegisters(0, 1)

# Of the probe and its answer, and of the longest request and answer, in RTU frames.
PROBE_SIZE, LONGEST_SIZE = 8 + 7, 8 + 256

NO_UNIT_CODES = [each.code for each in NO_UNIT]

# Of identification that are asked for; one has what most devices tell.
MOST_PAGES = 4

# A server that ends a connection; all else says that there will not be another one.
ENDINGS = (errno.ECONNRESET, errno.EPIPE, errno.ECONNABORTED)


class Answer(NamedTuple):
    """
    Somebody is there.

    Attributes:
        took: seconds.
        exception: its code, or None for a register.
    """

    took: float
    exception: int | None = None


class Nothing(NamedTuple):
    """
    Nobody is there, or nobody who can be understood.

    Attributes:
        error: what became of the probe.
    """

    error: ModbusError

    @property
    def is_gateway(self) -> bool:
        """Whether a gateway says so."""
        return isinstance(self.error, NO_UNIT)

    @property
    def is_noise(self) -> bool:
        """Whether bytes came that were no answer."""
        return not isinstance(self.error, ExceptionResponse) and bool(self.error.received)

    @property
    def is_never_silent(self) -> bool:
        """Whether the line gave no chance to ask."""
        return isinstance(self.error, FrameError) and not self.error.sent


class Late(NamedTuple):
    """An answer that came while another unit was asked."""

    unit: int
    answer: Answer


class Prober:
    """
    Asks the units of a place, one at a time.

    Attributes:
        context: the client.
        requests: how many were sent.
        waker: what the client waits with, and its clock.
    """

    def __init__(self, place: Place) -> None:
        self.requests: int = 0
        self._place = place
        self._unit = 0
        self._silent: set[int] = set()  # units whose probe has had no response so far
        self._pairing = TracePairing(is_server=False)
        self._late: list[Late] = []
        self._has_ids = place.endpoint.framing in ("tcp", "udp")
        self.context: Context = place.context(timeout=place.wait(PROBE_SIZE), trace=self._traced)
        self.waker: Waker = self.context._driver.waker

    # --- asking ---------------------------------------------------------------------------

    def probe(self, unit: int) -> Answer | Nothing:
        """
        Ask whether a unit is there.

        Raises:
            ModbusConnectionError: there is no connection any more.
        """
        self._unit = unit
        started = self.waker.now()
        self._silent.add(unit)
        try:
            self._carefully(unit, PROBE)
            code = None
        except NO_UNIT as error:
            return Nothing(error)
        except ExceptionResponse as error:
            code = error.code
        except ModbusConnectionError:
            raise
        except ModbusError as error:
            return Nothing(error)
        self._silent.discard(unit)
        return Answer(self.waker.now() - started, code)

    def server_id(self, unit: int) -> ServerId | None:
        """Ask for what function 17 tells; None if the unit has nothing to tell."""
        told: ServerId | None = self._told(unit, pdu.ReportServerId())
        return told

    def identification(self, unit: int) -> DeviceIdentification | None:
        """Ask for what function 43/14 tells, in a few pages at most; None if there is nothing."""
        steps = identify("regular")
        request = next(steps)
        told: DeviceIdentification | None = None
        objects: dict[int, bytes] = {}
        for _ in range(MOST_PAGES):
            page = self._told(unit, request)
            if page is None:
                break
            objects.update(page.objects)
            told = DeviceIdentification(page.conformity, objects, complete=False)
            try:
                request = steps.send(page)
            except StopIteration as done:
                told = done.value
                break
            except ModbusError:
                break
        return told

    def _told(self, unit: int, request: Any) -> Any:
        try:
            return self._carefully(unit, request, self._place.wait(LONGEST_SIZE))
        except ModbusConnectionError:
            raise
        except ModbusError:
            return None

    def read(self, unit: int, request: Reading) -> Any:
        """
        Ask anything that reads.

        Raises:
            ModbusError: what became of it; ModbusConnectionError if nothing more can be asked.
        """
        return self._carefully(unit, request, self._place.wait(LONGEST_SIZE))

    def _carefully(self, unit: int, request: Reading, timeout: float | None = None) -> Any:
        """Ask again over another connection, once, if the server ended this one."""
        handle: Any = self.context.for_unit(unit, timeout=timeout)
        try:
            return handle.execute(request)
        except ModbusConnectionError as error:
            self._check_alive(error)
        try:
            return handle.execute(request)
        except ModbusConnectionError as error:
            self._check_alive(error)
            raise _Ended(*error.args, errno=error.errno) from error

    def _check_alive(self, error: ModbusConnectionError) -> None:
        if self.context.closed or (self._has_ids and error.errno not in ENDINGS):
            raise error
        self.context.connect()

    # --- answers that come late ---------------------------------------------------------------

    def late(self) -> list[Late]:
        """Give what came since this was asked, of units that had been given up."""
        late, self._late = self._late, []
        return late

    def _traced(self, traced: Traced) -> None:
        self.requests += traced.direction == "sent"
        self._pairing.take(traced, self.waker.now())
        done, self._pairing.done = self._pairing.done, []
        for _, each in done:
            if each.unit != self._unit and each.unit in self._silent:
                self._note_late(each.unit, each)

    def _note_late(self, unit: int, probe: Transaction) -> None:
        if probe.kind not in ("answered", "exception", "late"):
            return
        code = probe.error.code if isinstance(probe.error, ExceptionResponse) else None
        self._silent.discard(unit)
        if code not in NO_UNIT_CODES:
            self._late.append(Late(unit, Answer(probe.duration or 0.0, code)))


class _Ended(ModbusError):
    """The server ended the connection, and another one: it does not want this question."""

    def __init__(self, reason: str = "", *, errno: int | None = None) -> None:
        super().__init__(reason)
        self.errno = errno
