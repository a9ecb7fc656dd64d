"""
A scan: all units at all settings, one after the other.
"""

from __future__ import annotations

import errno
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

from ...ports.endpoint import parse
from ...protocol.checks import checked_callback, integer
from ...protocol.errors import ModbusConnectionError
from ...protocol.mistakes import named_parameters
from ...protocol.pdu import DeviceIdentification, ServerId
from ...security.security import Security
from .places import FIRST_UNITS, USUAL_UNITS, Place, listed, places
from .probe import LONGEST_SIZE, MOST_PAGES, PROBE_SIZE, Answer, Nothing, Prober, Walk, Walker

__all__ = ["Found", "Progress", "Scan", "scan"]

UNITS = range(1, 248)

# The unit of a device that is connected to the network itself (messaging guide, 4.4.2).
DIRECT = 255

# Reserved units (serial line, 2.2), without 248, 254 and 255, which some devices answer for all.
RESERVED = (249, 252, 250, 251, 253)

# Timeouts after a probe: for function 17, after which the line must be silent for as long, and for
# the two levels of function 43/14.
MORE_ASKED = 2 + 2 * MOST_PAGES


class Progress(NamedTuple):
    """
    The progress of a scan.

    Attributes:
        setting: such as "9600 8E1"; the URL on networks.
        unit: the unit that is probed now.
        done, total: numbers of probes.
        left: seconds that the rest takes at most, if no more units are found.
    """

    setting: str
    unit: int
    done: int
    total: int
    left: float


@dataclass(frozen=True, slots=True)
class Found:
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


class Scan(Walker[Found]):
    """
    An iterator over `Found`, made by `scan`. The iteration can be stopped at any time.

    The scan sends requests while it is iterated, by one thread, and only reads. `close` may be
    called from any thread. The port is closed, and its settings are restored, by `close`, at the
    end, after an exception or Ctrl-C, and by garbage collection.

    Iterating raises ModbusConnectionError if the connection cannot be established or is lost, and
    whatever `on_progress` raises.

    Attributes:
        settings: the number of settings that are tried; 1 on networks.
        units: the units that are probed at each setting.
        total: the number of probes, if no unit is found.
        longest: the most seconds that the scan takes, if no unit is found.
        longest_first: the most seconds until the first units have been probed at all settings, if
            no unit is found; `longest` if there are no other units, or only one setting.
        longest_found: the most seconds that each unit found adds.
        tried: setting, such as "9600 8E1" (the URL on networks) -> the units that have been probed
            there so far.
        notes: other observations, one line each.
        requests: the number of requests sent.
    """

    def __init__(self, scanned: _PlacesScan) -> None:
        super().__init__(scanned)
        self.settings: int = scanned.settings
        self.units: list[int] = scanned.units
        self.total: int = scanned.total
        self.longest: float = scanned.longest
        self.longest_first: float = scanned.longest_first
        self.longest_found: float = scanned.longest_found
        self.tried: dict[str, list[int]] = scanned.tried
        self.notes: list[str] = scanned.notes


class _PlacesScan(Walk[Found]):
    """The scan of all places."""

    def __init__(
        self,
        asked_at: list[Place],
        rounds: list[list[int]],
        on_progress: Callable[[Progress], object] | None,
    ) -> None:
        super().__init__()
        self.notes: list[str] = []
        self.tried: dict[str, list[int]] = {}
        self.settings: int = len(asked_at)
        self.units: list[int] = [unit for units in rounds for unit in units]
        self.total: int = len(asked_at) * len(self.units)
        longest = [sum(_longest(place, len(units)) for place in asked_at) for units in rounds]
        self.longest: float = sum(longest)
        self.longest_first: float = longest[0]
        self.longest_found: float = max(map(_longest_found, asked_at))
        self._scans = [_UnitsScan(each, rounds, self._tell, self._skip) for each in asked_at]
        self._rounds = rounds
        self._on_progress = on_progress
        self._left = self.longest
        self._done = 0

    def steps(self) -> Generator[Found, None, None]:
        try:
            for number in range(len(self._rounds)):
                # The devices on a line have the same settings, mostly.
                for scan in sorted(self._scans, key=lambda each: not each.has_found):
                    yield from self._round(scan, number)
        finally:
            for scan in self._scans:
                self.notes += scan.seen()

    def _round(self, scan: _UnitsScan, number: int) -> Generator[Found, None, None]:
        """Ask the units of a round at one place."""
        if self.is_closed:
            return
        if scan.is_done:
            self._skip(scan.place, len(self._rounds[number]))
            return
        try:
            with self._asking(scan.place) as prober:
                yield from scan.steps(prober, number, self.notes)
        except ModbusConnectionError as error:
            if self.is_closed:
                return
            # A setting that this port refuses does not affect the others.
            if not (scan.place.is_serial and error.errno == errno.EINVAL):
                raise
            scan.refused = error
            self.notes.append(f"{scan.place}: {error}")
            self._skip(scan.place, len(self._rounds[number]))
            if all(each.refused is not None for each in self._scans):
                raise

    def _tell(self, place: Place, unit: int) -> None:
        if self._on_progress is not None:
            left = max(0.0, self._left)
            self._on_progress(Progress(str(place), unit, self._done, self.total, left))
        self.tried.setdefault(str(place), []).append(unit)
        self._skip(place, 1)

    def _skip(self, place: Place, count: int) -> None:
        self._done += count
        self._left -= count * _each(place)


class _UnitsScan:
    """
    The scan of all units at one place, in one round or several.

    Attributes:
        place: an endpoint with one setting.
        refused: raised because the port cannot have this setting.
        is_done: True if nothing is left to ask here, whatever the rounds still have.
    """

    def __init__(
        self,
        place: Place,
        rounds: list[list[int]],
        tell: Callable[[Place, int], None],
        skip: Callable[[Place, int], None],
    ) -> None:
        self.place = place
        self.refused: ModbusConnectionError | None = None
        self._is_left = False
        self._rounds = rounds
        self._units = [unit for units in rounds for unit in units]
        self._tell = tell
        self._skip = skip
        self._nothing: list[tuple[int, Nothing]] = []
        self._latest = 0.0
        self._is_known = False  # the response of units that cannot exist
        self._usual: Answer | None = None
        self._alike: list[tuple[int, Answer]] = []
        self._others = 0

    @property
    def is_done(self) -> bool:
        return self._is_left or self.refused is not None

    @property
    def has_found(self) -> bool:
        """True if a unit has answered here."""
        return bool(self._others or self._alike)

    def steps(self, prober: Prober, number: int, notes: list[str]) -> Generator[Found, None, None]:
        """Probe the units of a round; other observations are added to the notes."""
        units = self._rounds[number]
        for index, unit in enumerate(units):
            self._tell(self.place, unit)
            answer = prober.probe(unit)
            if isinstance(answer, Nothing):
                self._nothing.append((unit, answer))
                if answer.is_never_silent:
                    notes.append(
                        f"{self.place}: the line is never silent, so units were not probed from "
                        f"unit {unit} on; others send, perhaps at another rate or parity"
                    )
                    self._leave(len(units) - index - 1)
                    return
            else:
                if not self._is_known:
                    self._learn(prober)
                if self._usual is not None and self._usual.exception is None:
                    self._leave(len(units) - index - 1)
                    self._alike.append((unit, answer))
                    break
                if self._usual is not None and self._usual.exception == answer.exception:
                    self._alike.append((unit, answer))
                else:
                    self._others += 1
                    yield self._found(prober, unit, answer)
            yield from self._late(prober)
        if number == len(self._rounds) - 1 or self._is_left:
            yield from self._conclude(prober, notes)

    def _leave(self, left: int) -> None:
        """Leave out the rest of this round, and all further ones."""
        self._is_left = True
        self._skip(self.place, left)

    def _conclude(self, prober: Prober, notes: list[str]) -> Generator[Found, None, None]:
        if self._alike and not self._others:
            unit, answer = self._alike[0]
            notes.append(
                f"{self.place}: all units are answered alike, including reserved ones: "
                "the server ignores the unit, and is one device"
            )
            yield self._found(prober, unit, answer, is_any=True)

    def _learn(self, prober: Prober) -> None:
        """Probe two units that cannot exist: only a server that ignores the unit answers."""
        self._is_known = True
        chosen = [unit for unit in RESERVED if unit not in self._units][:2]
        answers = [prober.probe(unit) for unit in chosen]
        if len(answers) < 2:
            return
        first, second = answers
        if isinstance(first, Nothing) or isinstance(second, Nothing):
            return
        if first.exception == second.exception:
            self._usual = first

    def _late(self, prober: Prober) -> Generator[Found, None, None]:
        for unit, answer in prober.late():
            self._latest = max(self._latest, answer.took)
            if unit in self._units:
                self._nothing = [each for each in self._nothing if each[0] != unit]
                self._others += 1
                yield replace(self._made(unit, answer), is_late=True)

    def _found(self, prober: Prober, unit: int, answer: Answer, is_any: bool = False) -> Found:
        server_id = prober.server_id(unit)
        identification = prober.identification(unit)
        made = self._made(unit, answer)
        return replace(made, is_any=is_any, server_id=server_id, identification=identification)

    def _made(self, unit: int, answer: Answer) -> Found:
        return Found(unit, self.place.url(unit), *answer, **self.place.settings)

    # --- what was seen besides ------------------------------------------------------------

    def seen(self) -> Iterator[str]:
        """Yield other observations, one line each."""
        gateway = [unit for unit, nothing in self._nothing if nothing.is_gateway]
        if gateway:
            yield (
                f"{self.place}: a gateway reports {len(gateway)} units as absent "
                "(exception 10 or 11); they are not counted as found"
            )
        noise = [each for each in self._nothing if each[1].is_noise]
        if noise:
            unit, nothing = noise[0]
            hint = "; a device may use another rate or parity, or others send"
            yield (
                f"{self.place}: {len(noise)} of the probes brought bytes that are not a response"
                f"{hint * self.place.is_serial} (unit {unit}: {nothing.error.args[0]})"
            )
        if self._latest:
            yield (
                f"{self.place}: responses came late, after up to {self._latest:.2g} s; "
                "a longer timeout may find more"
            )
        if self._alike and self._others:
            yield (
                f"{self.place}: {len(self._alike)} units are answered like units that cannot "
                f"exist (exception {self._alike[0][1].exception}); they are not counted as found"
            )


def _each(place: Place) -> float:
    """Return the seconds that the probe of an absent unit takes."""
    spacing = float(place.endpoint.client_options.get("request_spacing", 0.0))
    silence = 3.5 * 11 / place.settings["baudrate"] if place.is_serial else 0.0
    return max(place.wait(PROBE_SIZE) + max(0.002, silence), spacing)


def _longest(place: Place, units: int) -> float:
    """Return the seconds for connecting and for units of which none answers."""
    delay = float(place.endpoint.client_options.get("connect_delay", 0.0))
    return units * _each(place) + place.timeout + delay


def _longest_found(place: Place) -> float:
    """Return the seconds that a unit which answers adds: two that cannot exist are asked, too."""
    return MORE_ASKED * place.wait(LONGEST_SIZE) + 2 * _each(place)


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
    asked_at = places(endpoint, baudrates, parities, timeout, security)
    if on_progress is not None:
        checked_callback("on_progress", on_progress)
    for place in asked_at:
        place.context().close()  # which checks the rest of the URL
    usual = _usual_units(asked_at[0])
    lowest = int(asked_at[0].has_broadcast)
    chosen = [integer("units", unit, lowest, 255) for unit in listed("units", units, usual)]
    rounds = [chosen]
    if units is None and len(asked_at) > 1 and len(usual) > len(USUAL_UNITS):
        rounds = [
            [*FIRST_UNITS],
            [unit for unit in USUAL_UNITS if unit not in FIRST_UNITS],
            [unit for unit in usual if unit not in USUAL_UNITS],
        ]
    return Scan(_PlacesScan(asked_at, rounds, on_progress))


def _usual_units(place: Place) -> list[int]:
    told = place.endpoint.client_options.get("unit")
    if told is not None:
        return [told]
    return [*UNITS] if place.has_broadcast else [*UNITS, DIRECT]
