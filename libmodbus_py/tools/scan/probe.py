"""
One request to one unit, and what its response says.

The probe reads one holding register at address 0 (function 3): most devices have this function,
and those that lack the function or the register answer with an exception, which is a response,
too (application protocol, section 7). The probe changes nothing in a device, and its echo is no
response to it.
"""

from __future__ import annotations

import contextlib
import errno
from abc import ABC, abstractmethod
from collections.abc import Generator, Iterator
from typing import Any, Generic, NamedTuple, Self, TypeVar

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
from ...protocol.pdu.interface import MANDATORY, identify
from ..listener.pairing import TracePairing
from ..listener.transaction import Transaction
from .places import Place

# fmt: off
__all__ = [
    "LONGEST_SIZE", "MOST_PAGES", "PROBE_SIZE", "Answer", "Late", "Nothing", "Prober", "Reading",
    "Walk", "Walker",
]
# fmt: on

# The only requests that are sent: none of them writes.
Reading = (
    pdu.ReadCoils
    | pdu.ReadDiscreteInputs
    | pdu.ReadHoldingRegisters
    | pdu.ReadInputRegisters
    | pdu.ReportServerId
    | pdu.ReadDeviceIdentification
)

PROBE = pdu.ReadHoldingRegisters(0, 1)

# Bytes of the probe and its response, and of the longest request and response, as RTU frames.
PROBE_SIZE, LONGEST_SIZE = 8 + 7, 8 + 256

NO_UNIT_CODES = [each.code for each in NO_UNIT]

# Pages of identification that are read; most devices have one.
MOST_PAGES = 4

# A server has closed the connection; other errors mean that another one would fail, too.
ENDINGS = (errno.ECONNRESET, errno.EPIPE, errno.ECONNABORTED)


class Answer(NamedTuple):
    """
    A unit has answered the probe.

    Attributes:
        took: seconds until the response.
        exception: the code of an exception response; None if it held a register.
    """

    took: float
    exception: int | None = None


class Nothing(NamedTuple):
    """
    No unit has answered the probe with a valid response.

    Attributes:
        error: raised by the client.
    """

    error: ModbusError

    @property
    def is_gateway(self) -> bool:
        """True if a gateway has answered that the unit is absent."""
        return isinstance(self.error, NO_UNIT)

    @property
    def is_noise(self) -> bool:
        """True if bytes came that are not a response."""
        return not isinstance(self.error, ExceptionResponse) and bool(self.error.received)

    @property
    def is_never_silent(self) -> bool:
        """True if the line was never silent, so that the probe was not sent."""
        return isinstance(self.error, FrameError) and not self.error.sent


class Late(NamedTuple):
    """A response that came during the probe of another unit."""

    unit: int
    answer: Answer


class Prober:
    """
    Sends requests to the units of a place, one at a time.

    Attributes:
        context: the client.
        requests: the number of requests sent.
        waker: wakes the client, and has its clock.
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

    # --- requests -------------------------------------------------------------------------

    def probe(self, unit: int) -> Answer | Nothing:
        """
        Send the probe to a unit.

        Raises:
            ModbusConnectionError: the connection is lost, and another one cannot be made.
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
        """Read the server id (function 17); None if the unit has none."""
        told: ServerId | None = self._told(unit, pdu.ReportServerId())
        return told

    def identification(self, unit: int) -> DeviceIdentification | None:
        """
        Read the identification (43/14), `MOST_PAGES` pages at most; None if there is none.

        Some devices leave the objects of the basic level out of the regular one.
        """
        told = self._level(unit, "regular")
        if told is not None and MANDATORY - told.objects.keys():
            basic = self._level(unit, "basic")
            if basic is not None:
                told = told._replace(objects={**basic.objects, **told.objects})
        return told

    def _level(self, unit: int, level: str) -> DeviceIdentification | None:
        steps = identify(level)
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
        Send any request that reads.

        Raises:
            ModbusError: the request failed; ModbusConnectionError if no other can be sent.
        """
        return self._carefully(unit, request, self._place.wait(LONGEST_SIZE))

    def _carefully(self, unit: int, request: Reading, timeout: float | None = None) -> Any:
        """Send a request again, once, over another connection if the server closed this one."""
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

    # --- late responses -----------------------------------------------------------------------

    def late(self) -> list[Late]:
        """Return the late responses since the last call."""
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
    """The server closed two connections in a row because of this request."""

    def __init__(self, reason: str = "", *, errno: int | None = None) -> None:
        super().__init__(reason)
        self.errno = errno


Item = TypeVar("Item")


class Walk(ABC, Generic[Item]):
    """The work of a `Walker`; it has no reference to it, so that a walker can be collected."""

    def __init__(self) -> None:
        self.is_closed: bool = False
        self._prober: Prober | None = None
        self._asked_before = 0

    @property
    def requests(self) -> int:
        """The number of requests sent."""
        return self._asked_before + (self._prober.requests if self._prober else 0)

    @abstractmethod
    def steps(self) -> Generator[Item, None, None]:
        """Send requests, and yield what they find."""

    @contextlib.contextmanager
    def _asking(self, place: Place) -> Iterator[Prober]:
        """Connect while the block runs; then close the port and restore its settings."""
        prober = self._prober = Prober(place)
        try:
            if self.is_closed:  # before this one could be closed
                prober.context.close()
            prober.context.connect()
            yield prober
        finally:
            prober.context.close()
            self._asked_before += prober.requests
            self._prober = None

    def close(self) -> None:
        """Let the request that is under way fail at once."""
        self.is_closed = True
        if (prober := self._prober) is not None:
            prober.context.close()


class Walker(Generic[Item]):
    """
    An iterator that sends requests while it is iterated, by one thread, and only reads.

    `close` may be called from any thread; `close`, the end, an exception, Ctrl-C and garbage
    collection close the connection and restore the settings of a serial port.
    """

    def __init__(self, walk: Walk[Item]) -> None:
        self.__walk: Walk[Item] = walk
        self.__steps: Generator[Item, None, None] = walk.steps()

    @property
    def requests(self) -> int:
        """The number of requests sent."""
        return self.__walk.requests

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        return next(self.__steps)

    def close(self) -> None:
        """Stop; any number of times, from any thread and from signal handlers."""
        self.__walk.close()
        with contextlib.suppress(ValueError):  # it is under way, and fails at once
            self.__steps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
