"""
The places of a scan, which are an endpoint with each setting that its line may have; and one
request to one unit there, with what its response says.

The probe reads one holding register at address 0 (function 3): most devices have this function,
and those that lack the function or the register answer with an exception, which is a response,
too (application protocol, section 7). The probe changes nothing in a device, and its echo is no
response to it.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, Self, TypeVar

from ...client.blocking import Client
from ...ports.endpoint import Endpoint
from ...ports.options import SERIAL_DEFAULTS, parity_of
from ...ports.trace import TracedFrame
from ...ports.waiting import Waker
from ...protocol import errors, pdu
from ...protocol.checks import checked_callback, integer, seconds
from ...protocol.errors import NO_UNIT, ExceptionResponse, ModbusConnectionError, ModbusError
from ...protocol.pdu import DeviceIdentification
from ...protocol.pdu.interface import identify
from ...security.security import Security
from ..listener.pairing import TracePairing

Item = TypeVar("Item")

State = TypeVar("State")

# In the order in which they are tried: those that most devices leave the factory with come first.
BAUDRATES = (9600, 19200, 38400, 57600, 115200, 4800, 2400, 1200)

PARITIES = ("E", "N", "O")

# Tried before all other rates and parities. The specification's default is 19200 8E1 (serial
# line, 3.4).
USUAL = ((9600, "E"), (9600, "N"), (19200, "E"), (19200, "N"))

# Where a line has several settings, the first units are asked at all of them, then the usual
# ones, then all others: nearly every device leaves the factory as one of the first.
FIRST_UNITS = (1, 2, 3, 247)
USUAL_UNITS = (*range(1, 11), 17, 100, 247)

# Serial line, 2.5.1: no parity means two stop bits. A receiver looks at the first one only, so
# this finds devices with one stop bit as well.
_STOP_BITS = {"E": 1, "N": 2, "O": 1}

# Default timeouts in seconds. After a request to another unit, a server made with libmodbus takes
# what comes within 0.5 s for that unit's response: a shorter timeout finds only every second such
# server, if any. On a network there may be a gateway, which waits for its own devices.
ON_LINES, ON_NETWORKS = 0.6, 1.0

# Bits of the longest character (serial line, 2.5.1), and characters per byte.
CHARACTER = 11
CHARACTERS = {"rtu": 1, "ascii": 2}

# Many timeouts only mean that units are absent; a new connection would lose late responses.
NEVER_DEAD = 1_000_000


@dataclass(frozen=True)
class Place:
    """An endpoint with one setting; `timeout` is without the time on the line, in seconds."""

    endpoint: Endpoint
    timeout: float
    security: Security | None = None

    @property
    def settings(self) -> dict[str, Any]:
        """Baud rate, parity, data bits and stop bits; empty on networks."""
        if not self.endpoint.is_serial:
            return {}
        settings = {**SERIAL_DEFAULTS, **self.endpoint.serial_settings}
        return {name: settings[name] for name in SERIAL_DEFAULTS}

    def __str__(self) -> str:
        if not self.endpoint.is_serial:
            return str(self.endpoint)
        return "{baudrate} {data_bits}{parity}{stop_bits}".format(**self.settings)

    def url(self, unit: int) -> str:
        """Return the URL of a client of a unit, with these settings."""
        others = {**self.endpoint.client_options, "unit": unit}
        return replace(self.endpoint, client_options=others).url

    def wait(self, size: int) -> float:
        """Return the timeout in seconds for a request and a response of this size together."""
        if not self.endpoint.is_serial:
            return self.timeout
        characters = size * CHARACTERS[self.endpoint.framing]
        return self.timeout + characters * CHARACTER / float(self.settings["baudrate"])

    def context(self, **options: Any) -> Client:
        """Make a client that repeats no request and sends none by itself."""
        options |= {"retries": 0, "busy_retries": 0, "max_pause": 0}
        options["timeouts_before_reconnect"] = NEVER_DEAD
        if self.endpoint.has_transactions:
            # Even where all responses come from unit 255.
            options["accept_unit"] = "any"
        if self.security is not None:
            options["security"] = self.security
        return Client(self.endpoint.url, **options)


def places(
    endpoint: Endpoint,
    baudrates: Iterable[int] | None,
    parities: Iterable[str] | None,
    timeout: float | None,
    security: Security | None = None,
) -> list[Place]:
    """Return the endpoint with each setting; the URL gives the settings that no argument gives."""
    if timeout is None:
        usual = ON_LINES if endpoint.is_serial else ON_NETWORKS
        timeout = endpoint.client_options.get("timeout", usual)
    timeout = seconds("timeout", timeout)
    if not endpoint.is_serial:
        for name, items in (("baudrates", baudrates), ("parities", parities)):
            if items is not None:
                raise ValueError(f"{name} are for serial ports, not for {endpoint.scheme}://")
        return [Place(endpoint, timeout, security)]
    options = endpoint.options
    rates = [options["baudrate"]] if "baudrate" in options else BAUDRATES
    kinds = [options["parity"]] if "parity" in options else PARITIES
    settings = [
        (integer("baudrate", rate, 1, 4_000_000), parity)
        for rate in distinct("baudrates", baudrates, rates)
        for parity in dict.fromkeys(map(parity_of, distinct("parities", parities, kinds)))
    ]
    if baudrates is None and parities is None:
        settings.sort(key=lambda setting: USUAL.index(setting) if setting in USUAL else len(USUAL))
    result = []
    for rate, parity in settings:
        line = {"stop_bits": _STOP_BITS[parity], **options, "baudrate": rate, "parity": parity}
        setting = replace(endpoint, options=line)
        result.append(Place(setting, timeout, security))
    return result


def distinct(name: str, items: Iterable[Item] | None, usual: Iterable[Item]) -> list[Item]:
    """Return each value once, in the order given."""
    source = usual if items is None else items
    if not isinstance(source, Iterable):
        raise TypeError(f"{name} must be a list, not {type(items).__name__}")
    result = list(dict.fromkeys(source))
    if not result:
        raise ValueError(f"{name} must hold at least one")
    return result


def checked_progress(function: Callable[[State], object] | None) -> Callable[[State], object]:
    """Return a function of a user that takes the progress, or one that does nothing."""
    return (lambda state: None) if function is None else checked_callback("on_progress", function)


# --- requests -----------------------------------------------------------------------------------

PROBE = pdu.ReadHoldingRegisters(0, 1)

# Bytes of the probe and its response, and of the longest request and response, as RTU frames.
PROBE_SIZE, LONGEST_SIZE = 8 + 7, 8 + 256

NO_UNIT_CODES = [error.code for error in NO_UNIT]

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

    context: Client
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
        """Make the request in flight, and all later ones, fail at once."""
        self.is_closed = True
        self._close()

    def probe(self, unit: int) -> Answer | ModbusError:
        """Send the probe to a unit; return its answer, or the error."""
        self._unit = unit
        start = self.waker.now()
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
        return Answer(self.waker.now() - start, code)

    def identification(self, unit: int) -> DeviceIdentification | None:
        """Read the regular identification (43/14), without a page that is wrong."""
        steps = identify("regular")
        identification: DeviceIdentification | None = None
        objects: dict[int, bytes] = {}
        try:
            request = next(steps)
            for _ in range(MOST_PAGES):
                page = self.read_any(unit, request)
                if page is None:
                    break
                objects.update(page.objects)
                identification = DeviceIdentification(page.conformity, objects, complete=False)
                request = steps.send(page)
        except StopIteration as stop:
            identification = stop.value
        except errors.InvalidResponse:
            pass
        return identification

    def read_any(self, unit: int, request: Any) -> Any:
        """Send a request that units may lack; return None if it fails."""
        try:
            return self.read(unit, request)
        except ModbusConnectionError:
            raise
        except ModbusError:
            return None

    def read(self, unit: int, request: Any, size: int = LONGEST_SIZE) -> Any:
        """Send a request that reads, again once if the server has closed the connection."""
        handle: Any = self.context.for_unit(unit, timeout=self._place.wait(size))
        reason = ""
        for _ in range(2):
            try:
                return handle.execute(request)
            except ModbusConnectionError as error:
                has_ids = self._place.endpoint.has_transactions
                if self.context.closed or (has_ids and error.errno not in ENDINGS):
                    raise
                reason = str(error)
            self.context.connect()
        raise ModbusError(reason)

    # --- late responses -----------------------------------------------------------------------

    def late(self) -> list[tuple[int, Answer]]:
        """Return the responses of other units since the last call, which came late."""
        late, self._late = self._late, []
        return late

    def _traced(self, frame: TracedFrame) -> None:
        self.requests += frame.direction == "sent"
        self._pairing.take(frame, self.waker.now())
        pairs, self._pairing.done = self._pairing.done, []
        for _, transaction in pairs:
            is_answer = transaction.kind in ("answered", "exception", "late")
            if is_answer and transaction.unit != self._unit and transaction.unit in self._silent:
                error = transaction.error
                code = error.code if isinstance(error, ExceptionResponse) else None
                self._silent.discard(transaction.unit)
                if code not in NO_UNIT_CODES:
                    self._late.append((transaction.unit, Answer(transaction.duration or 0.0, code)))


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
        try:
            return next(self.__steps)
        except ModbusConnectionError:
            if self.__prober.is_closed:  # as `close` has a request under way fail
                raise StopIteration from None
            raise

    def close(self) -> None:
        """Stop; any number of times, from any thread and from signal handlers."""
        self.__prober.close()
        with contextlib.suppress(ValueError):  # it is under way, and fails at once
            self.__steps.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
