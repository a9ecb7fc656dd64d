"""Routes: the line of each unit, and the requests that are allowed; options for all lines."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sized
from dataclasses import dataclass, field
from typing import Literal

from ...client.options import checked_options
from ...device.access import Access
from ...device.authorization import Allow
from ...ports.endpoint import Endpoint, parse
from ...ports.hosts import EVERYWHERE, is_loopback, is_this_machine
from ...ports.port import make_port
from ...protocol.checks import integer, seconds
from ...protocol.mistakes import Path, WrongType, WrongValue, inside, named_arguments, placed
from ...protocol.plain import units_of as units_in

COUNTERS = tuple(f"8/{number}" for number in range(11, 19))

HARMLESS: tuple[int | str, ...] = (7, 11, 12, 17, "43/14", "8/0", "8/2", *COUNTERS)
"""Functions that are forwarded although they access no table: they do not change a device."""


@named_arguments
@dataclass(frozen=True)
class Route:
    """
    A line, and the units that are reached over it.

    Args:
        url: the URL of the line, with its settings and the options of clients, such as
            "rtu:///dev/ttyUSB0?baudrate=19200&timeout=0.5". Routes with the same URL share one
            connection.
        units: the units that clients use: numbers 0..255, or text such as "1-10,17"; None for
            1..247, or 0..254 if the line is Modbus/TCP or UDP.
        device_units: the units of the devices on the line, as many, in the same order; or one
            for all; None for the same as `units`.
        cache: the greatest age of a cached response to a read (functions 1 to 4), in seconds,
            0..86400; 0 for no cache.
        merge: True to send equal waiting reads (functions 1 to 4) only once.
        read_only: True to forward only requests that do not write.
        writable: the addresses that may be written, as `write` of `Allow`; None for all. With it,
            and with `read_only`, requests that may write to unknown places are refused.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    url: str
    units: str | Iterable[int] | None = None
    device_units: str | int | Iterable[int] | None = None
    cache: float = 0.0
    merge: bool = False
    read_only: bool = False
    writable: Literal["all"] | Iterable[str | Access] | None = None
    endpoint: Endpoint = field(init=False, repr=False, compare=False)
    ways: dict[int, int] = field(init=False, repr=False, compare=False)
    allow: Allow | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        with inside("url"):
            endpoint = parse(self.url)
            if "unit" in endpoint.client_options:
                raise ValueError(f"{self.url!r} must not contain unit; use device_units")
            # Invalid options of the client are refused now, not when the client is made.
            make_port(endpoint, checked_options(endpoint, {}))
        _check_flag("merge", self.merge)
        _check_flag("read_only", self.read_only)
        if self.read_only and self.writable is not None:
            raise WrongValue.about("writable", "must not be given with read_only")
        seconds("cache", self.cache, low=0)
        units: Iterable[int] = range(255) if endpoint.has_transactions else range(1, 248)
        if self.units is not None:
            units = units_of("units", self.units)
        self._set(endpoint=endpoint, units=tuple(units), allow=self._allow())
        self._set(ways=self._ways(tuple(units)))

    def _set(self, **values: object) -> None:
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _ways(self, units: tuple[int, ...]) -> dict[int, int]:
        device_units = self.device_units
        if twice := [unit for unit in units if units.count(unit) > 1]:
            raise WrongValue.about("units", f"{min(twice)} is given twice")
        if device_units is None:
            return dict(zip(units, units, strict=True))
        numbers = units_of(
            "device_units", [device_units] if isinstance(device_units, int) else device_units
        )
        self._set(device_units=tuple(numbers))
        if len(numbers) not in (1, len(units)):
            raise WrongValue(
                "device_units", f"must be one, or {len(units)} as units, not {len(numbers)}"
            )
        return dict(zip(units, numbers if len(numbers) > 1 else numbers * len(units), strict=True))

    def _allow(self) -> Allow | None:
        if self.read_only:
            return Allow(read="all", functions=HARMLESS)
        if self.writable is None:
            return None
        try:
            rule = Allow(read="all", write=self.writable, functions=HARMLESS)
        except (TypeError, ValueError) as error:
            raise placed(error, ()).renamed(("writable",)) from None
        self._set(writable="all" if self.writable == "all" else rule.write)
        return rule


def _check_flag(name: str, value: object) -> None:
    if not isinstance(value, bool):
        raise WrongType(name, f"must be True or False, not {value!r}")


def units_of(name: str, units: object) -> list[int]:
    """Read units: numbers, or text such as "1-10,17"; messages of errors begin with `name`."""
    if isinstance(units, str):
        try:
            numbers = units_in(units)
        except ValueError as error:
            raise WrongValue.about(name, f"{error}") from None
    elif isinstance(units, Iterable):
        numbers = [integer((name, at), unit, 0, 255) for at, unit in enumerate(units)]
    else:
        raise WrongType(name, f"must be text or a list, not {type(units).__name__}")
    if not numbers:
        raise WrongValue(name, "must hold at least one")
    return numbers


def parse_route(text: str, units: Iterable[int] | None = None) -> Route:
    """
    Read a route of a command line: a URL, or ``UNITS=URL``, or ``UNITS:DEVICE_UNITS=URL``; `units`
    are those of a URL alone.
    """
    before, equals, url = text.partition("=")
    if not equals or "://" in before or "?" in before:
        return Route(text, units)
    unit_text, colon, device_units = before.partition(":")
    return Route(url, unit_text, device_units if colon else None)


def check_routes(routes: Iterable[Route], name: str = "routes") -> None:
    """
    Refuse two routes for one unit, and two to the same host and port or serial port with different
    options; `name` is that of the list.
    """
    units: set[int] = set()
    places: dict[tuple[str, str], tuple[int, str]] = {}
    for at, route in enumerate(routes):
        if not isinstance(route, Route):
            raise WrongType((name, at), f"must be a Route, not {type(route).__name__}")
        endpoint = route.endpoint
        first, url = places.setdefault(endpoint.key, (at, endpoint.url))
        if url != endpoint.url:
            reason = f"{name}[{first}] has other options for the same connection: {url}"
            raise WrongValue.about((name, at, "url"), reason)
        for unit in route.ways:
            if unit in units:
                reason = f"an earlier route has unit {unit} already"
                raise WrongValue.about((name, at, "units"), reason)
            units.add(unit)


def check_line(name: Path, line: Endpoint, listening: Iterable[Endpoint]) -> None:
    """Refuse a serial port that does not exist, and a line that leads to the gateway itself."""
    if line.is_serial and not os.path.exists(line.path):
        raise WrongValue.about(name, f"there is no serial port {line.path}")
    for own in listening:
        if _is_same(line, own):
            raise WrongValue.about(name, f"the gateway itself listens on {own}")


def _is_same(line: Endpoint, own: Endpoint) -> bool:
    if line.key == own.key:
        return True
    if line.key[0] != own.key[0] or line.port != own.port:
        return False
    if line.has_path:
        return os.path.realpath(line.path) == os.path.realpath(own.path)
    if own.host in EVERYWHERE:
        return is_this_machine(line.host)
    is_here = line.host in EVERYWHERE or is_loopback(line.host)
    return is_here and is_loopback(own.host)


@dataclass(frozen=True)
class GatewayOptions:
    """Options of a gateway; the documentation of `Gateway` describes them."""

    own_units: str | Iterable[int] = (255,)
    queue: int = 16
    longest_wait: float = 5.0
    writes_first: bool = False
    own: frozenset[int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        own_units = self.own_units
        units = (
            []
            if isinstance(own_units, Sized) and not len(own_units)
            else units_of("own_units", own_units)
        )
        object.__setattr__(self, "own", frozenset(units))
        integer("queue", self.queue, 1, 1024)
        seconds("longest_wait", self.longest_wait)
        _check_flag("writes_first", self.writes_first)
