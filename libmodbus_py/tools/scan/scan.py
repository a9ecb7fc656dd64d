"""A scan: all units at all settings, one after the other."""

from __future__ import annotations

import errno
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import NamedTuple

from ...ports.endpoint import parse
from ...protocol import pdu
from ...protocol.checks import integer
from ...protocol.errors import NO_UNIT, ModbusConnectionError, ModbusError
from ...protocol.mistakes import named_parameters
from ...protocol.pdu import DeviceIdentification, ServerId
from ...security.security import Security
from . import probe
from .probe import Answer, Place, Prober, Walker

UNITS = range(1, 248)

# The unit of a device that is connected to the network itself (messaging guide, 4.4.2).
DIRECT = 255

# Reserved units (serial line, 2.2), without 248, 254 and 255, which some devices answer for all.
RESERVED = (249, 252, 250, 251, 253)

# Timeouts after a probe: for function 17, after which the line must be silent for as long, and for
# function 43/14.
MORE_ASKED = 2 + probe.MOST_PAGES


class Progress(NamedTuple):
    """The progress of a scan: the unit that is probed now, and the numbers of probes."""

    setting: str  # such as "9600 8E1"; the URL on networks
    unit: int
    done: int
    total: int
    left: float  # seconds that the rest takes at most, if no more units are found


@dataclass(frozen=True, slots=True)
class FoundUnit:
    """
    A unit that answered.

    Attributes:
        unit: 0..255.
        url: a URL for clients of the unit, with all settings.
        took: the seconds until its response.
        exception: the code of its exception response; None if the register could be read.
        baudrate, parity, data_bits, stop_bits: the settings of the serial port; None on networks.
        is_late: True if the response came only during the probe of another unit.
        is_any: True if the server answers all units in the same way, including reserved ones, so
            that it is one device.
        server_id: the result of function 17, or None.
        identification: the result of function 43/14, or None.
    """

    unit: int
    url: str
    took: float
    exception: int | None
    baudrate: int | None = None
    parity: str | None = None
    data_bits: int | None = None
    stop_bits: int | None = None
    is_late: bool = False
    is_any: bool = False
    server_id: ServerId | None = None
    identification: DeviceIdentification | None = None


class Scan(Walker[FoundUnit]):
    """
    An iterator over `FoundUnit`, made by `scan`. The iteration can be stopped at any time.

    The scan sends requests while it is iterated, by one thread, and only reads. `close` may be
    called from any thread. The port is closed, and its settings are restored, by `close`, at the
    end, after an exception or Ctrl-C, and by garbage collection.

    Iterating raises ModbusConnectionError if the connection cannot be established or is lost, and
    whatever `on_progress` raises.

    Attributes:
        settings: the number of settings that are tried; 1 on networks.
        units: the units that are probed at each setting.
        total: the number of probes, if no unit is found.
        longest: the most seconds that the scan takes, if no unit is found; twice as many on a
            line that is never silent.
        longest_first: the most seconds until the first units have been probed at all settings, if
            no unit is found; `longest` if there are no other units, or only one setting.
        longest_found: the most seconds that each unit found adds.
        tried: setting, such as "9600 8E1" (the URL on networks) -> the units that have been probed
            there so far.
        notes: other observations, one line each.
        requests: the number of requests sent.
    """

    def __init__(
        self,
        asked_at: list[Place],
        rounds: list[list[int]],
        on_progress: Callable[[Progress], object],
    ) -> None:
        self.settings: int = len(asked_at)
        self.units: list[int] = [unit for units in rounds for unit in units]
        self.total: int = len(asked_at) * len(self.units)
        longest = [sum(_longest(place, len(units)) for place in asked_at) for units in rounds]
        self.longest: float = sum(longest)
        self.longest_first: float = longest[0]
        # Two units that cannot exist are asked, too.
        self.longest_found: float = max(
            MORE_ASKED * place.wait(probe.LONGEST_SIZE) + 2 * _each(place) for place in asked_at
        )
        scans = [_PlaceScan(place, self.units) for place in asked_at]
        plan = _Rounds(scans, rounds, on_progress, self.total, self.longest)
        self.tried: dict[str, list[int]] = plan.tried
        self.notes: list[str] = plan.notes
        prober = Prober()
        super().__init__(prober, plan.steps(prober))


@dataclass
class _Rounds:
    """The scan of all places, in one round of units or several."""

    scans: list[_PlaceScan]
    rounds: list[list[int]]
    on_progress: Callable[[Progress], object]
    total: int
    left: float  # seconds
    tried: dict[str, list[int]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)

    def steps(self, prober: Prober) -> Generator[FoundUnit, None, None]:
        count = 0
        try:
            for units in self.rounds:
                # The devices on a line have the same settings, mostly.
                for scan in sorted(self.scans, key=lambda scan: not scan.has_found):
                    if not scan.is_left:
                        tell = partial(self._tell, scan.place, count)
                        yield from scan.steps(prober, units, tell)
                    count += len(units)
                    self.left -= len(units) * _each(scan.place)
                    if scan.refused is not None and all(other.refused for other in self.scans):
                        raise scan.refused
        finally:
            for scan in self.scans:
                self.notes += (f"{scan.place}: {note}" for note in scan.notes())

    def _tell(self, place: Place, before: int, at: int, unit: int) -> None:
        """Report the probe of a unit, with its index in the round, after probes elsewhere."""
        seconds = max(0.0, self.left - at * _each(place))
        self.on_progress(Progress(str(place), unit, before + at, self.total, seconds))
        self.tried.setdefault(str(place), []).append(unit)


class _PlaceScan:
    """The scan of all units at one place, in one round or several."""

    def __init__(self, place: Place, units: list[int]) -> None:
        self.place = place
        self.is_left: bool = False  # nothing is left to ask here
        self.refused: ModbusConnectionError | None = None  # the port cannot have this setting
        self._units = units
        self._unit_errors: dict[int, ModbusError] = {}
        self._latest = 0.0
        self._others = 0
        # Units with the same answer as units that cannot exist, and the answer.
        self._alike: list[tuple[int, Answer]] = []
        self._impossible: set[int | None] | None = None

    @property
    def has_found(self) -> bool:
        return bool(self._others or self._alike)

    def steps(
        self, prober: Prober, units: list[int], tell: Callable[[int, int], None]
    ) -> Generator[FoundUnit, None, None]:
        """Probe the units of a round; `tell` is called with the index of each, and the unit."""
        try:
            with prober.at(self.place):
                for at, unit in enumerate(units):
                    tell(at, unit)
                    yield from self._probe(prober, unit)
                    if self.is_left:
                        break
                is_over = self.is_left or units[-1] == self._units[-1]
                if self._alike and not self._others and is_over:
                    yield self._found_unit(prober, *self._alike[0], is_any=True)
        except ModbusConnectionError as error:
            # A setting that this port refuses does not affect the others.
            if prober.is_closed or not self.place.endpoint.is_serial or error.errno != errno.EINVAL:
                raise
            self.refused, self.is_left = error, True

    def _probe(self, prober: Prober, unit: int) -> Generator[FoundUnit, None, None]:
        answer = prober.probe(unit)
        if isinstance(answer, ModbusError):
            self._unit_errors[unit] = answer
        elif answer.exception in self._answers_of_none(prober):
            self._alike.append((unit, answer))
            self.is_left = answer.exception is None
        else:
            self._others += 1
            yield self._found_unit(prober, unit, answer)
        for late, answer in prober.late():
            self._latest = max(self._latest, answer.took)
            if late in self._units:
                self._unit_errors.pop(late, None)
                self._others += 1
                yield replace(self._found_unit(prober, late, answer), is_late=True)

    def _answers_of_none(self, prober: Prober) -> set[int | None]:
        """Return the answer of units that cannot exist: a server that ignores the unit has one."""
        if self._impossible is None:
            units = [unit for unit in RESERVED if unit not in self._units][:2]
            answers = [prober.probe(unit) for unit in units]
            codes = [answer.exception for answer in answers if isinstance(answer, Answer)]
            self._impossible = set(codes) if len(codes) == 2 and len(set(codes)) == 1 else set()
        return self._impossible

    def _found_unit(
        self, prober: Prober, unit: int, answer: Answer, is_any: bool = False
    ) -> FoundUnit:
        return FoundUnit(
            unit,
            self.place.url(unit),
            *answer,
            **self.place.settings,
            is_any=is_any,
            server_id=prober.read_any(unit, pdu.ReportServerId()),
            identification=prober.identification(unit),
        )

    def notes(self) -> Iterator[str]:
        if self.refused is not None:
            yield str(self.refused)
        errors = list(self._unit_errors.values())
        if gateway := sum(isinstance(error, NO_UNIT) for error in errors):
            yield (
                f"a gateway reports {gateway} units as absent (exception 10 or 11);"
                " they are not counted as found"
            )
        noise = [error for error in errors if error.received and not isinstance(error, NO_UNIT)]
        if noise:
            hint = "; a device may use another rate or parity, or others send"
            yield (
                f"{len(noise)} of the probes brought bytes that are not a response"
                f"{hint * self.place.endpoint.is_serial} (unit {noise[0].unit}: {noise[0].args[0]})"
            )
        if self._latest:
            after = f"after up to {self._latest:.2g} s"
            yield f"responses came late, {after}; a longer timeout may find more"
        if self._alike and not self._others:
            yield (
                "all units are answered alike, including reserved ones: the server ignores the"
                " unit, and is one device"
            )
        elif self._alike:
            yield (
                f"{len(self._alike)} units are answered like units that cannot exist (exception"
                f" {self._alike[0][1].exception}); they are not counted as found"
            )


def _each(place: Place) -> float:
    """Return the seconds that the probe of an absent unit takes."""
    spacing = float(place.endpoint.client_options.get("request_spacing", 0.0))
    return max(place.wait(probe.PROBE_SIZE) + max(0.002, place.endpoint.pause), spacing)


def _longest(place: Place, units: int) -> float:
    """Return the seconds for connecting and for units of which none answers."""
    delay = float(place.endpoint.client_options.get("connect_delay", 0.0))
    return units * _each(place) + place.timeout + delay


@named_parameters
def scan(
    url: str,
    *,
    baudrates: Iterable[int] | None = None,
    parities: Iterable[str] | None = None,
    units: Iterable[int] | None = None,
    timeout: float | None = None,
    security: Security | None = None,
    on_progress: Callable[[Progress], object] | None = None,
) -> Scan:
    """
    Find the units that respond at an endpoint, only by reading.

    Holding register 0 of each unit is read at each setting. An exception counts as a response,
    except 10 and 11, with which gateways report an absent unit. Units that respond also get
    functions 17 and 43/14. Nothing is sent before the result is iterated.

    If no units are given and there are several settings to try, units 1, 2, 3 and 247 are probed
    first, at all settings; then other usual units, and then all others, beginning with the settings
    at which a unit has responded.

    Args:
        url: a URL as for clients. Its baud rate, parity, unit and timeout are used unless the
            following arguments are given.
        baudrates: for serial ports; None for 9600, 19200, 38400, 57600, 115200, 4800, 2400 and
            1200. If neither baud rates nor parities are given, 9600 and 19200 with even and with
            no parity are tried first.
        parities: for serial ports; None for "E", "N" and "O". Stop bits are those of the URL;
            if it has none, 2 without parity and 1 with parity, which finds devices with any
            number of stop bits.
        units: the units to probe, 0..255, but not 0 where it is a broadcast; None for 1..247, and
            255 on tcp, tls and udp.
        timeout: seconds for each response, 0.001..86400; None for 0.6 on serial ports and 1
            elsewhere.
        security: for "tls", unless the URL contains these options.
        on_progress: called with a `Progress` before each probe.

    Returns:
        An iterator over the units found.

    Raises:
        TypeError, ValueError: an argument is wrong; the message names it and its range.
    """
    endpoint = parse(url)
    asked_at = probe.places(endpoint, baudrates, parities, timeout, security)
    on_progress = probe.checked_progress(on_progress)
    for place in asked_at:
        place.context().close()  # which checks the rest of the URL
    unit = endpoint.client_options.get("unit")
    usual = [*UNITS, *[DIRECT] * endpoint.has_transactions] if unit is None else [unit]
    lowest = int(not endpoint.has_transactions)  # without them 0 is a broadcast
    numbers = [
        integer("units", unit, lowest, 255) for unit in probe.distinct("units", units, usual)
    ]
    rounds = [numbers]
    if units is None and len(asked_at) > 1 and len(usual) > len(probe.USUAL_UNITS):
        rounds = [
            [*probe.FIRST_UNITS],
            [unit for unit in probe.USUAL_UNITS if unit not in probe.FIRST_UNITS],
            [unit for unit in usual if unit not in probe.USUAL_UNITS],
        ]
    return Scan(asked_at, rounds, on_progress)
