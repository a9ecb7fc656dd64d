"""
The devices of a fleet, as frozen values, and as JSON that can be stored; and the table ``[engine]``
of fleet files, which is checked wherever the file is read, on one machine too.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import lru_cache, partial
from typing import Any, Literal, get_args
from weakref import WeakValueDictionary

from ...client.options import checked_options
from ...files.schema import Key, Keys, flag, one_of, whole
from ...maps.point import Point
from ...maps.point_checks import checked_interval
from ...maps.register_map import RegisterMap
from ...maps.watched import PartialPlans
from ...ports.endpoint import Endpoint, parse
from ...ports.port import make_port
from ...protocol.checks import integer, number, seconds
from ...protocol.json_text import json_text
from ...protocol.mistakes import Mistake, WrongType, WrongValue, inside, item, named_arguments
from ...protocol.tables import WriteFunction, checked_write_function

LONGEST_NAME = 100

OWN_LABELS = ("device", "name", "unit")
"""Labels of metrics that are not those of a device."""


@named_arguments
@dataclass(frozen=True, slots=True)
class DeviceConfig:
    """
    One device: its connection, the points that are read, and the interval.

    Args:
        name: 1 to 100 printable characters, unique in the fleet.
        url: the URL of the connection, with its options, but without `unit`.
        map: the points of the device.
        unit: the unit of the device, 0..255.
        items: names of the points that are read; by default, all readable points of the map.
        groups: names of groups of points that are read, too (`Point.group`).
        gap: the most unneeded registers or bits in a row that are read to save a request, 0..2000.
        max_registers: the most registers that one request may read from the device, 1..125.
        interval: seconds from one poll to the next, 0.01..86400, of points without an interval of
            their own (`Point.interval`).
        timeout: seconds for one request; None for the timeout of the URL.
        spacing: seconds between a response of the device and the next request to it; a pause
            for all devices of a line is ``request_spacing`` in its URL.
        write_function: the functions that write its points: "auto", "single" or "multiple"; None
            for those of the URL.
        on_change: True to report only values that changed.
        dead_bands: by name of a point, by how much a value must differ from the last one
            reported.
        at_least: seconds within which each point is reported again though its value, or its error,
            is the same, 0.01..86400; None for no such time.
        labels: labels of the device, in its readings and metrics.
        zone: the zone of the device; workers poll the devices of their zones only. Empty for none.

    Attributes:
        endpoint: the connection, as parsed from the URL.
        connection_key: devices with the same key share a connection.
        reads: the points that are read, and the requests for them.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range; the message begins with
            its name.
    """

    name: str
    url: str
    map: RegisterMap = field(repr=False)
    unit: int = 1
    items: tuple[str, ...] = ()
    groups: tuple[str, ...] = ()
    gap: int = 0
    max_registers: int = 125
    interval: float = 10.0
    timeout: float | None = None
    spacing: float = 0.0
    write_function: WriteFunction | None = None
    on_change: bool = False
    dead_bands: Mapping[str, float] = field(default_factory=dict)
    at_least: float | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    zone: str = ""
    endpoint: Endpoint = field(init=False, repr=False, compare=False)
    connection_key: str = field(init=False, repr=False, compare=False)
    reads: Reads = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        change = partial(object.__setattr__, self)
        _check_text("name", self.name, 1)
        _check_text("zone", self.zone, 0)
        with inside("url"):
            endpoint, key = _endpoint(self.url)
        change("endpoint", endpoint)
        change("connection_key", key)
        integer("unit", self.unit, 0, 255)
        is_broadcast = endpoint.client_options.get("broadcast", not endpoint.has_transactions)
        if self.unit == 0 and is_broadcast:
            reason = "must not be 0 on this transport without broadcast=0 in its URL"
            raise WrongValue("unit", f"{reason}: no device answers a broadcast")
        if not isinstance(self.map, RegisterMap):
            raise WrongType("map", f"must be a RegisterMap, not {type(self.map).__name__}")
        points = [point for point in self.map.values() if point.access != "write"]
        if not points:
            raise WrongValue.about("map", "the map has no point that can be read")
        change("items", _names("items", self.items, "point", (point.name for point in points)))
        groups = (point.group for point in points if point.group)
        change("groups", _names("groups", self.groups, "group", groups))
        integer("gap", self.gap, 0, 2000)
        integer("max_registers", self.max_registers, 1, 125)
        change("reads", _reads_of(self))
        checked_interval("interval", self.interval)
        if self.timeout is not None:
            seconds("timeout", self.timeout)
        seconds("spacing", self.spacing, low=0)
        if self.write_function is not None:
            checked_write_function(self.write_function)
        flag(("on_change",), self.on_change)
        for name, band in _table("dead_bands", self.dead_bands).items():
            if name not in self.names:
                raise WrongValue.about(("dead_bands", name), "no point of this name is read")
            number(("dead_bands", name), band, 0, math.inf)
        if self.at_least is not None:
            checked_interval("at_least", self.at_least)
        names = {*OWN_LABELS}
        for label, value in _table("labels", self.labels).items():
            _check_text(("labels", label), value, 0)
            name = label_name(label)
            if not name or name.startswith("__") or name in names:
                reason = f"{name!r}, its name in Prometheus, is not allowed, or used already"
                raise WrongValue.about(("labels", label), reason)
            names.add(name)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the points that are read."""
        return self.reads.names


class Reads(PartialPlans):
    """The points of a kind of device, and the requests for them; thousands of devices share one."""

    def __init__(self, config: DeviceConfig) -> None:
        points = [point for point in config.map.values() if point.access != "write"]
        if config.items or config.groups:
            of_groups = [point.name for point in points if point.group in config.groups]
            names = dict.fromkeys([*config.items, *of_groups])
            points = [config.map[name] for name in names]
        with inside("max_registers"):
            super().__init__(
                config.map,
                [point.name for point in points],
                gap=config.gap,
                max_registers=config.max_registers,
            )
        self.units: tuple[str, ...] = tuple(point.units for point in points)
        self.intervals: tuple[float | None, ...] = tuple(point.interval for point in points)


_READS: WeakValueDictionary[tuple[Any, ...], Reads] = WeakValueDictionary()


def _reads_of(config: DeviceConfig) -> Reads:
    """Return what devices with the same map and the same points share, as long as one uses it."""
    key = (id(config.map), config.items, config.groups, config.gap, config.max_registers)
    reads = _READS.get(key)
    if reads is None:
        reads = _READS[key] = Reads(config)
    return reads


def label_name(key: str) -> str:
    """Return the name that a label has in Prometheus: other characters are written _ there."""
    return re.sub(r"^(?=\d)|\W", "_", key, flags=re.ASCII)


def _names(key: str, value: object, kind: str, choices: Iterable[str]) -> tuple[str, ...]:
    """Return names of what is known, each once."""
    if isinstance(value, str) or not isinstance(value, Iterable):
        raise WrongType(key, f"must be a list of names, not {type(value).__name__}")
    names = tuple(value)
    if not names:
        return names
    choices = [*dict.fromkeys(choices)]
    for at, name in enumerate(names):
        if name not in choices:
            some = ", ".join(choices[:8]) + ", ..." * (len(choices) > 8)
            reason = f"the map has no {kind} {name!r} to read; it has {some}"
            raise WrongValue.about(item(key, at), reason)
    return tuple(dict.fromkeys(names))


def _table(key: str, value: object) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise WrongType(key, f"must be a table, not {type(value).__name__}")
    return value


def _check_text(name: str | tuple[str, ...], value: object, least: int) -> None:
    if not isinstance(value, str):
        raise WrongType(name, f"must be text, not {type(value).__name__}")
    if not least <= len(value) <= LONGEST_NAME or not value.isprintable():
        range_text = f"{least}..{LONGEST_NAME} characters that can be printed"
        raise WrongValue(name, f"must have {range_text}, not {value[:LONGEST_NAME]!r}")


@lru_cache(maxsize=4096)
def _endpoint(url: str) -> tuple[Endpoint, str]:
    """Return the endpoint of a URL, which devices of a connection share, and its connection key."""
    endpoint = parse(url)
    if "unit" in endpoint.client_options:
        raise ValueError(f"{url!r} must not contain unit; write it as a key: unit = ...")
    # Invalid options of the client are refused now, not when the client is made.
    make_port(endpoint, checked_options(endpoint, {}))
    # Workers of other versions read the key, so that its form does not change.
    return endpoint, f"{endpoint.transport}:{endpoint.key[1]}"


def by_connection(devices: Iterable[DeviceConfig]) -> dict[str, list[DeviceConfig]]:
    """Return the devices of each connection, by connection key, in their order."""
    groups: dict[str, list[DeviceConfig]] = {}
    for device in devices:
        groups.setdefault(device.connection_key, []).append(device)
    return groups


def conflicts(devices: Iterable[DeviceConfig]) -> Iterator[tuple[int, Mistake]]:
    """
    Yield the index and the mistake of each device that does not fit to those before it: the same
    name, or other options for the same host and port or serial port.
    """
    names: set[str] = set()
    lines: dict[str, DeviceConfig] = {}
    for at, device in enumerate(devices):
        if not isinstance(device, DeviceConfig):
            raise TypeError(f"devices[{at}] must be a DeviceConfig, not {type(device).__name__}")
        if device.name in names:
            reason = f"{device.name!r} is also the name of another device"
            yield at, WrongValue.about("name", reason)
        names.add(device.name)
        first = lines.setdefault(device.connection_key, device)
        url = first.endpoint.url
        # Equal URLs have mostly the same object, whose text need not be compared.
        if first.endpoint is not device.endpoint and url != device.endpoint.url:
            reason = f"{first.name!r} has other options for the same connection: {url}"
            yield at, WrongValue.about("url", reason)


def checked_devices(devices: Iterable[DeviceConfig]) -> list[DeviceConfig]:
    """Return the devices of one fleet as a list; raise the first of their `conflicts`."""
    if not isinstance(devices, Iterable):
        kind = type(devices).__name__
        raise WrongType("devices", f"must be a list of DeviceConfig, not {kind}")
    items = list(devices)
    for at, mistake in conflicts(items):
        raise mistake.under(("devices", at))
    return items


# --- as text ----------------------------------------------------------------------------------


def _defaults(kind: Any) -> dict[str, Any]:
    """Return the defaults of the arguments of a dataclass; MISSING for those that are required."""
    return {
        row.name: row.default if row.default_factory is MISSING else row.default_factory()
        for row in fields(kind)
        if row.init
    }


DEVICE, POINT = _defaults(DeviceConfig), _defaults(Point)
del DEVICE["map"]  # most devices share a map: each is written once


def devices_to_json(devices: Iterable[DeviceConfig]) -> str:
    """Return devices, with their maps, as JSON; equal devices give equal text."""
    maps: dict[str, int] = {}
    indexes: dict[int, int] = {}
    rows = []
    for device in devices:
        key = id(device.map)
        if key not in indexes:
            text = json_text([_changed(point, POINT) for point in device.map.values()])
            indexes[key] = maps.setdefault(text, len(maps))
        rows.append({**_changed(device, DEVICE), "map": indexes[key]})
    return f'{{"maps": [{", ".join(maps)}], "devices": {json_text(rows)}}}'


def devices_from_json(text: str) -> list[DeviceConfig]:
    """Read the JSON of `devices_to_json`; equal maps become one object. Raises ValueError."""
    try:
        content = json.loads(text)
        maps = [_map_from_json(json_text(points)) for points in content["maps"]]
        return [DeviceConfig(**{**keys, "map": maps[keys["map"]]}) for keys in content["devices"]]
    except (TypeError, LookupError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"the text does not describe devices: {error}") from None


@lru_cache(maxsize=4096)
def _map_from_json(text: str) -> RegisterMap:
    return RegisterMap([Point(**keys) for keys in json.loads(text)])


def _changed(value: object, defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return the arguments of a value that differ from their defaults."""
    arguments = {name: getattr(value, name) for name in defaults}
    return {
        name: dict(argument) if isinstance(argument, Mapping) else argument
        for name, argument in arguments.items()
        if argument != defaults[name]
    }


# --- [engine] ---------------------------------------------------------------------------------

OnLoss = Literal["stop", "continue"]

SHORTEST_LEASE, LONGEST_LEASE = 0.5, 60.0

# Ten years, in seconds.
LONGEST_AGE = 3.2e8

# fmt: off
ENGINE = Keys([
    Key("lease", lambda path, value: seconds(path, value, SHORTEST_LEASE, LONGEST_LEASE),
        "how long a worker may poll without NATS, in seconds, 0.5..60"),
    Key("on_engine_loss", one_of(*get_args(OnLoss)), "what workers do when NATS is lost"),
    Key("commands", flag, "whether points may be written through NATS"),
    Key("max_age", lambda path, value: seconds(path, value, high=LONGEST_AGE),
        "how long NATS keeps readings, in seconds"),
    Key("max_bytes", whole(1 << 16, 1 << 50), "how many bytes of readings NATS keeps"),
])
# fmt: on
