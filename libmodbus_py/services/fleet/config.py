"""
The devices of a fleet, as frozen values, and as JSON that can be stored; and the table ``[engine]``
of fleet files, which is checked wherever the file is read, on one machine too.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import lru_cache
from typing import Any, Literal, get_args

from ...client.options import CheckedOptions
from ...maps.point import Point
from ...maps.point_checks import LONGEST_INTERVAL, SHORTEST_INTERVAL
from ...maps.point_plan import PointPlan
from ...maps.register_map import RegisterMap
from ...ports.endpoint import Endpoint, parse
from ...ports.port import make_port
from ...protocol.checks import integer, number, seconds
from ...protocol.json_text import json_text
from ...protocol.mistakes import Path, WrongType, WrongValue, inside, named_arguments
from ...tools.files.schema import Key, Keys, flag, one_of, whole

# fmt: off
__all__ = [
    "ENGINE", "LONGEST_LEASE", "SHORTEST_LEASE", "DeviceConfig", "OnLoss", "by_connection",
    "checked", "devices_from_json", "devices_to_json", "label_name",
]
# fmt: on


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
        items: names of the points that are read; all readable points of the map unless given.
        groups: names of groups of points that are read, too (`Point.group`).
        gap: the most unneeded registers or bits in a row that are read to save a request, 0..2000.
        max_registers: the most registers that one request may read from the device, 1..125.
        interval: seconds from one poll to the next, 0.01..86400, of points without an interval of
            their own (`Point.interval`).
        timeout: seconds for one request; None for the timeout of the URL.
        spacing: seconds between a response of the device and the next request to it; a pause
            for all devices of a line is ``request_spacing`` in its URL.
        on_change: True to report only values that changed.
        dead_bands: by name of a point, by how much a value must differ from the last one
            reported.
        labels: labels of the metrics of the device.
        zone: the zone of the device; workers poll the devices of their zones only. Empty for none.

    Attributes:
        endpoint: the connection, as parsed from the URL.
        connection_key: devices with the same key share a connection.

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
    on_change: bool = False
    dead_bands: Mapping[str, float] = field(default_factory=dict)
    labels: Mapping[str, str] = field(default_factory=dict)
    zone: str = ""
    endpoint: Endpoint = field(init=False, repr=False, compare=False)
    connection_key: str = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        _text("name", self.name, 1)
        _text("zone", self.zone, 0)
        with inside("url"):
            endpoint, key = _endpoint(self.url)
        object.__setattr__(self, "endpoint", endpoint)
        object.__setattr__(self, "connection_key", key)
        integer("unit", self.unit, 0, 255)
        if self.unit == 0 and not self.endpoint.has_transactions:
            raise WrongValue(
                "unit", "must not be 0 on this transport: no device answers a broadcast"
            )
        if not isinstance(self.map, RegisterMap):
            raise WrongType("map", f"must be a RegisterMap, not {type(self.map).__name__}")
        object.__setattr__(self, "items", _items(self.items, self.map))
        object.__setattr__(self, "groups", _groups(self.groups, self.map))
        integer("gap", self.gap, 0, 2000)
        integer("max_registers", self.max_registers, 1, 125)
        self.plan()
        seconds("interval", self.interval, SHORTEST_INTERVAL, LONGEST_INTERVAL)
        if self.timeout is not None:
            seconds("timeout", self.timeout)
        seconds("spacing", self.spacing, low=0)
        if not isinstance(self.on_change, bool):
            raise WrongType("on_change", f"must be true or false, not {self.on_change!r}")
        self._check_dead_bands()
        if not isinstance(self.labels, Mapping):
            raise WrongType("labels", f"must be a table, not {type(self.labels).__name__}")
        self._check_labels()

    def _check_labels(self) -> None:
        names: dict[str, str] = dict.fromkeys(OWN_LABELS, "of every metric")
        for key, value in self.labels.items():
            _text(("labels", key), value, 0)
            name = label_name(key)
            if not name or name.startswith("__"):
                reason = f"Prometheus does not accept the label {key!r}"
                raise WrongValue.about(("labels", key), reason)
            if name in names:
                reason = f"in Prometheus, {name!r} is the label {names[name]}"
                raise WrongValue.about(("labels", key), reason)
            names[name] = f"of {key!r}"

    def _check_dead_bands(self) -> None:
        if not isinstance(self.dead_bands, Mapping):
            raise WrongType("dead_bands", f"must be a table, not {type(self.dead_bands).__name__}")
        for name, band in self.dead_bands.items():
            if name not in self.names:
                raise WrongValue.about(("dead_bands", name), "no point of this name is read")
            number(("dead_bands", name), band, 0, math.inf)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the points that are read."""
        if not self.groups:
            return self.items or readable(self.map)
        of_groups = [name for group in self.groups for name in self.map.group(group)]
        return tuple(dict.fromkeys([*self.items, *of_groups]))

    def plan(self, names: Iterable[str] | None = None) -> PointPlan:
        """
        Return the requests of a poll.

        Args:
            names: of points; None for all that are read.

        Raises:
            ValueError: a value has more registers than `max_registers`.
        """
        try:
            wanted = self.names if names is None else names
            return self.map.plan(wanted, gap=self.gap, max_registers=self.max_registers)
        except ValueError as error:
            raise WrongValue.about("max_registers", f"{error}") from None


def label_name(key: str) -> str:
    """Return the name that a label has in Prometheus: other characters are written _ there."""
    return re.sub(r"^(?=\d)|\W", "_", key, flags=re.ASCII)


def readable(points: RegisterMap) -> tuple[str, ...]:
    """Return the names of all points that can be read."""
    return tuple(name for name, point in points.items() if point.access != "write")


def _names(key: str, given: object, check: Callable[[str], str]) -> tuple[str, ...]:
    """Return names as a tuple; `check` returns what is wrong with one."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise WrongType(key, f"must be a list of names, not {type(given).__name__}")
    names = tuple(given)
    for at, name in enumerate(names):
        reason = check(name) or (f"{name!r} is given twice" if name in names[:at] else "")
        if reason:
            raise WrongValue.about((key, at), reason)
    return names


def _items(given: object, points: RegisterMap) -> tuple[str, ...]:
    def check(name: str) -> str:
        if name not in points:
            some = ", ".join([*points][:8]) + ", ..." * (len(points) > 8)
            return f"the map has no {name!r}; it has {some}"
        return f"{name!r} can only be written" if points[name].access == "write" else ""

    items = _names("items", given, check)
    if not (items or readable(points)):
        raise WrongValue.about("map", "the map has no point that can be read")
    return items


def _groups(given: object, points: RegisterMap) -> tuple[str, ...]:
    def check(name: str) -> str:
        try:
            points.group(name)
        except ValueError as error:
            return str(error)
        return ""

    return _names("groups", given, check)


def _text(name: str | Path, value: object, least: int) -> None:
    if not isinstance(value, str):
        raise WrongType(name, f"must be text, not {type(value).__name__}")
    if not least <= len(value) <= LONGEST_NAME or not value.isprintable():
        wanted = f"{least}..{LONGEST_NAME} characters that can be printed"
        raise WrongValue(name, f"must have {wanted}, not {value[:LONGEST_NAME]!r}")


@lru_cache(maxsize=4096)
def _endpoint(url: str) -> tuple[Endpoint, str]:
    """Return the endpoint of a URL, and its connection key."""
    endpoint = parse(url)
    if "unit" in endpoint.client_options:
        raise ValueError(f"{url!r} must not contain unit; write it as a key: unit = ...")
    # Invalid options of the client are refused now, not when the client is made.
    make_port(endpoint, CheckedOptions.of(endpoint, {}))
    # Workers of other versions read the key, so that its form does not change.
    return endpoint, f"{endpoint.transport}:{endpoint.key[1]}"


def by_connection(devices: Iterable[DeviceConfig]) -> dict[str, list[DeviceConfig]]:
    """Return the devices of each connection, by connection key, in their order."""
    found: dict[str, list[DeviceConfig]] = {}
    for device in devices:
        found.setdefault(device.connection_key, []).append(device)
    return found


def checked(
    devices: Iterable[DeviceConfig], called: Callable[[int], str] = "devices[{}]".format
) -> list[DeviceConfig]:
    """
    Return the devices of one fleet as a list; `called` returns the name, for errors, of a device.

    Raises:
        TypeError, ValueError: two devices have the same name, or the same host and port or serial
            port with different options; the path of the error begins with "devices" and the index.
    """
    found = list(devices)
    names: dict[str, int] = {}
    places: dict[str, int] = {}
    for at, device in enumerate(found):
        if not isinstance(device, DeviceConfig):
            reason = f"must be a DeviceConfig, not {type(device).__name__}"
            raise WrongType(("devices", at), reason)
        first = names.setdefault(device.name, at)
        if first != at:
            reason = f"{device.name!r} is also the name of {called(first)}"
            raise WrongValue.about(("devices", at, "name"), reason)
        first = places.setdefault(device.connection_key, at)
        endpoint = found[first].endpoint
        # Equal URLs have mostly the same object, whose text need not be made then.
        if endpoint is not device.endpoint and endpoint.url != device.endpoint.url:
            url = endpoint.url
            reason = f"{called(first)} has other options for the same connection: {url}"
            raise WrongValue.about(("devices", at, "url"), reason)
    return found


# --- as text ----------------------------------------------------------------------------------

DEVICE = tuple(each for each in fields(DeviceConfig) if each.init and each.name != "map")

POINT = tuple(each for each in fields(Point) if each.init)


def devices_to_json(devices: Iterable[DeviceConfig]) -> str:
    """Return devices, with their maps, as JSON; equal devices give equal text."""
    maps: dict[str, int] = {}
    seen: dict[int, int] = {}  # most devices share a map: each is written once
    found = []
    for device in devices:
        if id(device.map) not in seen:
            seen[id(device.map)] = maps.setdefault(_map_to_json(device.map), len(maps))
        found.append({**_changed(device, DEVICE), "map": seen[id(device.map)]})
    return f'{{"maps": [{", ".join(maps)}], "devices": {json_text(found)}}}'


def devices_from_json(text: str) -> list[DeviceConfig]:
    """
    Read devices from the JSON of `devices_to_json`. Equal maps become one object.

    Raises:
        ValueError: the text is not valid.
    """
    try:
        content = json.loads(text)
        maps = [_map_from_json(json_text(each)) for each in content["maps"]]
        return [_device(each, maps) for each in content["devices"]]
    except (TypeError, LookupError, AttributeError, ValueError, RecursionError) as error:
        raise ValueError(f"the text does not describe devices: {error}") from None


def _device(given: dict[str, Any], maps: list[RegisterMap]) -> DeviceConfig:
    return DeviceConfig(
        **{
            **given,
            "map": maps[given["map"]],
            **{key: tuple(given.get(key, ())) for key in ("items", "groups")},
        }
    )


def _map_to_json(points: RegisterMap) -> str:
    return json_text([_changed(point, POINT) for point in points.values()])


@lru_cache(maxsize=4096)
def _map_from_json(text: str) -> RegisterMap:
    return RegisterMap([Point(**each) for each in json.loads(text)])


def _changed(value: object, of: Iterable[Any]) -> dict[str, Any]:
    """Return the fields of a value that differ from their defaults."""
    found: dict[str, Any] = {}
    for each in of:
        given = getattr(value, each.name)
        usual = each.default_factory() if each.default_factory is not MISSING else each.default
        if given != usual:
            found[each.name] = dict(given) if isinstance(given, Mapping) else given
    return found


OnLoss = Literal["stop", "continue"]

SHORTEST_LEASE, LONGEST_LEASE = 0.5, 60.0

# Ten years, in seconds.
LONGEST_AGE = 3.2e8


def _lease(path: Path, value: object) -> float:
    return seconds(path, value, SHORTEST_LEASE, LONGEST_LEASE)


def _age(path: Path, value: object) -> float:
    return seconds(path, value, high=LONGEST_AGE)


ENGINE = Keys(
    [
        Key("lease", _lease, "how long a worker may poll without NATS, in seconds, 0.5..60"),
        Key("on_engine_loss", one_of(*get_args(OnLoss)), "what workers do when NATS is lost"),
        Key("commands", flag, "whether points may be written through NATS"),
        Key("max_age", _age, "how long NATS keeps readings, in seconds"),
        Key("max_bytes", whole(1 << 16, 1 << 50), "how many bytes of readings NATS keeps"),
    ]
)
