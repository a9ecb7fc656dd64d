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
from collections.abc import Callable, Generator, Iterator
from typing import Any, Generic, NamedTuple, Self, TypeVar

from ...client.blocking import Context
from ...ports.trace import Traced
from ...ports.waiting import Waker
from ...protocol import pdu
from ...protocol.errors import NO_UNIT, ExceptionResponse, ModbusConnectionError, ModbusError
from ...protocol.pdu import DeviceIdentification, ServerId
from ...protocol.pdu.interface import MANDATORY, identify
from ..listener.pairing import TracePairing
from .places import Place

__all__ = ["LONGEST_SIZE", "MOST_PAGES", "PROBE_SIZE", "Answer", "Prober", "Reading", "Walker"]

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
    """A response: the seconds until it came, and the code of an exception or None."""

    took: float
    exception: int | None = None


class Prober:
    """Sends requests to the units of one place after the other; `waker` has the clock."""

    context: Context
    waker: Waker

    def __init__(self) -> None:
        self.requests: int = 0
        self.is_closed: bool = False
        self._close: Callable[[], None] = lambda: None

    @contextlib.contextmanager
    def at(self, place: Place) -> Iterator[None]:
        """Connect while the block runs; then close the port and restore its settings."""
        self._place = place
        self._unit = 0
        self._silent: set[int] = set()  # units whose probe has had no response so far
        self._late: list[tuple[int, Answer]] = []
        self._pairing = TracePairing(is_server=False)
        self.context = place.context(timeout=place.wait(PROBE_SIZE), trace=self._traced)
        self.waker = self.context._driver.waker
        self._close = self.context.close
        try:
            if self.is_closed:  # before this one could be closed
                self.context.close()
            self.context.connect()
            yield
        finally:
            self.context.close()

    def close(self) -> None:
        """Let the request that is under way, and all others, fail at once."""
        self.is_closed = True
        self._close()

    def probe(self, unit: int) -> Answer | ModbusError:
        """
        Send the probe to a unit; return its answer, or why there is none.

        Raises:
            ModbusConnectionError: the connection is lost, and another one cannot be made.
        """
        self._unit = unit
        started = self.waker.now()
        self._silent.add(unit)
        code = None
        try:
            self.read(unit, PROBE, PROBE_SIZE)
        except ModbusConnectionError:
            raise
        except ModbusError as error:
            if not isinstance(error, ExceptionResponse) or isinstance(error, NO_UNIT):
                return error
            code = error.code
        self._silent.discard(unit)
        return Answer(self.waker.now() - started, code)

    def server_id(self, unit: int) -> ServerId | None:
        """Read the server id (function 17); None if the unit has none."""
        found: ServerId | None = self._read_any(unit, pdu.ReportServerId())
        return found

    def identification(self, unit: int) -> DeviceIdentification | None:
        """
        Read the identification (43/14), `MOST_PAGES` pages at most; None if there is none.

        Some devices leave the objects of the basic level out of the regular one.
        """
        found = self._level(unit, "regular")
        if found is not None and MANDATORY - found.objects.keys():
            basic = self._level(unit, "basic")
            if basic is not None:
                found = found._replace(objects={**basic.objects, **found.objects})
        return found

    def _level(self, unit: int, level: str) -> DeviceIdentification | None:
        steps = identify(level)
        found: DeviceIdentification | None = None
        objects: dict[int, bytes] = {}
        try:
            request = next(steps)
            for _ in range(MOST_PAGES):
                page = self._read_any(unit, request)
                if page is None:
                    break
                objects.update(page.objects)
                found = DeviceIdentification(page.conformity, objects, complete=False)
                request = steps.send(page)
        except StopIteration as done:
            found = done.value
        except ModbusConnectionError:
            raise
        except ModbusError:
            pass  # a wrong page
        return found

    def _read_any(self, unit: int, request: Any) -> Any:
        """Send a request that units may lack; return None if it fails."""
        try:
            return self.read(unit, request)
        except ModbusConnectionError:
            raise
        except ModbusError:
            return None

    def read(self, unit: int, request: Reading, size: int = LONGEST_SIZE) -> Any:
        """
        Send any request that reads: again, once, if the server closes the connection.

        Raises:
            ModbusError: the request failed; ModbusConnectionError if no other can be sent.
        """
        handle: Any = self.context.for_unit(unit, timeout=self._place.wait(size))
        reason = ""
        for _ in range(2):
            try:
                return handle.execute(request)
            except ModbusConnectionError as error:
                if self.context.closed or (self._place.has_ids and error.errno not in ENDINGS):
                    raise
                reason = str(error)
            self.context.connect()
        raise ModbusError(reason)

    # --- late responses -----------------------------------------------------------------------

    def late(self) -> list[tuple[int, Answer]]:
        """Return the responses of other units since the last call, which came late."""
        late, self._late = self._late, []
        return late

    def _traced(self, traced: Traced) -> None:
        self.requests += traced.direction == "sent"
        self._pairing.take(traced, self.waker.now())
        done, self._pairing.done = self._pairing.done, []
        for _, each in done:
            is_answer = each.kind in ("answered", "exception", "late")
            if is_answer and each.unit != self._unit and each.unit in self._silent:
                code = each.error.code if isinstance(each.error, ExceptionResponse) else None
                self._silent.discard(each.unit)
                if code not in NO_UNIT_CODES:
                    self._late.append((each.unit, Answer(each.duration or 0.0, code)))


Item = TypeVar("Item")


class Walker(Generic[Item]):
    """An iterator that sends requests; `steps` does not refer to it, so that it is collected."""

    def __init__(self, prober: Prober, steps: Generator[Item, None, None]) -> None:
        self.__prober = prober
        self.__steps = steps

    @property
    def requests(self) -> int:
        """The number of requests sent."""
        return self.__prober.requests

    def __iter__(self) -> Iterator[Item]:
        return self

    def __next__(self) -> Item:
        return next(self.__steps)

    def close(self) -> None:
        """Stop; any number of times, from any thread and from signal handlers."""
        self.__prober.close()
        with contextlib.suppress(ValueError):  # it is under way, and fails at once
            self.__steps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
