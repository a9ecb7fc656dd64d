"""
Configurations by which Home Assistant finds devices and points at a broker ("MQTT discovery").

Each entity, a value that Home Assistant shows or sets, has a retained message of its own. It is
published at the start, or before the first reading of a device that is added, and deleted when
readings say that the point was removed: a device that another worker polls now is not removed.

Its topic is made of names, so that it is the same in each run and for each worker: what an earlier
run with another file left is what the broker retains below the own node and no device has. A node
belongs to the `status` topic of pollers.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from hashlib import blake2b
from typing import Any, Literal, NamedTuple

from ....maps.point import Point
from ....protocol.json_text import json_text
from ....version import __version__
from ..config import DeviceConfig
from ..readings import Reading
from .mqtt_connection import Message
from .topics import Topic

PREFIX = "homeassistant"
"""The first level of the topics of configurations, unless Home Assistant is told otherwise."""

# Device class -> its units of measurement, in the spelling of Home Assistant, which ignores an
# entity whose unit its class does not have. Units of several classes (%, dB, ppm) have none here,
# nor has K, which maps use for differences: Home Assistant would convert these to °C.
DEVICE_CLASSES = {
    "apparent_power": ("VA", "kVA"),
    "conductivity": ("S/cm", "mS/cm", "µS/cm"),
    "current": ("A", "mA"),
    "distance": ("km", "m", "cm", "mm"),
    "duration": ("d", "h", "min", "s", "ms"),
    "energy": ("Wh", "kWh", "MWh", "GWh", "J", "kJ", "MJ", "GJ"),
    "frequency": ("Hz", "kHz", "MHz", "GHz"),
    "illuminance": ("lx",),
    "irradiance": ("W/m²",),
    "power": ("mW", "W", "kW", "MW", "GW"),
    "pressure": ("Pa", "hPa", "kPa", "mbar", "bar", "psi"),
    "reactive_power": ("var", "kvar"),
    "signal_strength": ("dBm",),
    "speed": ("m/s", "km/h", "mm/s"),
    "temperature": ("°C", "°F"),
    "voltage": ("mV", "V", "kV"),
    "volume": ("m³", "L", "mL"),
    "volume_flow_rate": ("m³/h", "m³/s", "L/h", "L/min", "L/s"),
    "weight": ("kg", "g"),
}

CLASS_OF = {unit: name for name, units in DEVICE_CLASSES.items() for unit in units}

# Other spellings of units in maps.
SPELLINGS = {
    "C": "°C", "degC": "°C", "F": "°F", "degF": "°F", "VAr": "var", "VAR": "var", "kVAr": "kvar",
    "kVAR": "kvar", "m3": "m³", "l": "L", "ml": "mL", "m3/h": "m³/h", "m3/s": "m³/s", "l/h": "L/h",
    "l/min": "L/min", "l/s": "L/s", "W/m2": "W/m²", "uS/cm": "µS/cm", "lux": "lx", "sec": "s",
}  # fmt: skip

# Classes of amounts, which have no momentary value; and those whose totals may only rise.
AMOUNTS = ("energy", "volume")
RISING = (*AMOUNTS, "distance", "duration", "weight", None)

# The bounds of a number, which must have some, if only its device knows its scale.
WIDEST = -1e9, 1e9

SMALLEST_STEP = 0.001  # the least step of a number that Home Assistant accepts
LONGEST_TEXT = 255  # the most characters of a text that Home Assistant sets
LONGEST_SLUG = 60  # the characters of names in an identifier, which a digest makes unlike others


class Topics(NamedTuple):
    """The topics that configurations name; that of readings is for points, or for devices."""

    status: str
    device_status: Topic
    readings: Topic
    point: Topic
    is_of_points: bool
    takes_commands: bool


class Discovery:
    """The configurations that the broker retains, and that it should retain."""

    def __init__(self, topics: Topics) -> None:
        self._topics = topics
        self._node = identifier(topics.status)
        self.filter: str = f"{PREFIX}/+/{self._node}/+/config"
        self.devices: Mapping[str, DeviceConfig] = {}
        # Those whose configurations were published, and the names of those that have not changed
        # since. Another worker may have changed what it polled meanwhile.
        self.published: dict[str, DeviceConfig] = {}
        self._current: set[str] = set()
        # Devices of the start without a reading: if they are removed, no reading says so.
        self._unread: set[str] = set()
        # Topics of configurations that the broker retained before the start.
        self._retained: set[str] = set()

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        self._current = {
            name for name in self._current & devices.keys() if devices[name] == self.devices[name]
        }
        self.devices = devices

    def start(self) -> None:
        """Publish the configurations of all devices with the next ones that are published again."""
        self.published = dict(self.devices)
        self._current, self._unread = {*self.devices}, {*self.devices}

    def add_topic(self, topic: str) -> None:
        """Note a configuration that the broker retained before the start."""
        self._retained.add(topic)

    def leftovers(self, *, is_alone: bool) -> set[str]:
        """Return the topics of retained configurations that no device has; none beside others."""
        if not is_alone:
            self._retained.clear()
        if not self._retained:
            return set()
        devices = self.devices.values()
        return self._retained - {topic for device in devices for topic, _ in self._entities(device)}

    # --- messages -----------------------------------------------------------------------------

    def changed(self, readings: Sequence[Reading]) -> dict[str, DeviceConfig | None]:
        """Return devices of readings that the broker does not know so; None for removed ones."""
        devices: dict[str, DeviceConfig | None] = dict.fromkeys(
            self._unread - self.devices.keys() - {reading.device for reading in readings}
        )
        for reading in readings:
            name = reading.device
            if name in self._current:
                continue
            device = self.devices.get(name)
            if device is not None or (reading.quality == "offline" and name in self.published):
                devices[name] = device
        return devices

    def messages(self, devices: Mapping[str, DeviceConfig | None]) -> Iterator[Message]:
        """Yield the configurations of devices, and empty messages, which delete former ones."""
        for name, device in devices.items():
            former, after = (
                {} if config is None else dict(self._entities(config))
                for config in (self.published.get(name), device)
            )
            for topic in former.keys() - after.keys():
                yield Message(topic, b"")
            for topic, entity in after.items():
                yield Message(topic, json_text(entity).encode())

    def keep_devices(
        self,
        devices: Mapping[str, DeviceConfig | None],
        readings: Sequence[Reading],
        leftovers: set[str],
    ) -> None:
        """Note that messages with devices, and readings behind them, were published."""
        self._retained -= leftovers
        self._unread -= {*devices} | {reading.device for reading in readings}
        for name, device in devices.items():
            if device is None:
                del self.published[name]
            else:
                self.published[name] = device
                if self.devices.get(name) is device:  # not changed meanwhile
                    self._current.add(name)

    def last_messages(self) -> Iterator[Message]:
        """Yield the configurations that were published, which the broker may have lost."""
        return self.messages(
            {name: config for name, config in self.published.items() if name in self.devices}
        )

    # --- entities -----------------------------------------------------------------------------

    def _entities(self, device: DeviceConfig) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the topic and the configuration of each entity of a device."""
        topics, read = self._topics, {*device.names}
        within = topics.status, topics.point.template
        common = {
            "availability": [
                {"topic": topics.status},
                {"topic": topics.device_status.of(device.labels, device=device.name)},
            ],
            "availability_mode": "all",
            "device": {
                "identifiers": [identifier(device.name, within=within)],
                "name": device.name,
            },
            "origin": {"name": "libmodbus-py", "sw_version": __version__},
        }
        for point in device.map.values():
            if point.is_readable and point.name not in read:  # not among the items
                continue
            names = {"device": device.name, "name": point.name}
            own = topics.point.of(device.labels, **names)
            commands = {}
            if topics.takes_commands and point.is_writable:
                commands["command_topic"] = f"{own}/set"
            states, value = {}, ""
            if point.name in read:
                states["state_topic"] = own
                value = "value_json.value"
                if not topics.is_of_points:
                    states["state_topic"] = topics.readings.of(device.labels, device=device.name)
                    value = f'value_json["values"][{_quoted(point.name)}].value'
            for part in _parts(point):
                component, keys = _component(point, part, value, is_set=bool(commands))
                if component not in READ_ONLY:
                    keys |= commands
                elif not states:
                    continue
                id_ = identifier(device.name, point.name, part.name, within=within)
                name = f"{point.name} {part.name}".strip()
                entity = {"name": name, "unique_id": id_, **states, **keys, **common}
                yield f"{PREFIX}/{component}/{self._node}/{id_}/config", entity


def identifier(*names: str, within: tuple[str, ...] = ()) -> str:
    """Return names as an identifier: they may hold what topics of configurations may not."""
    text = re.sub("[^A-Za-z0-9-]+", "_", " ".join(names)).strip("_")
    digest = blake2b("\0".join([*within, *names]).encode(), digest_size=8).hexdigest()
    return f"{text[:LONGEST_SLUG]}_{digest}"


# --- entities ----------------------------------------------------------------------------------

Kind = Literal["states", "flag", "number", "time", "text"]

# Kind of a value -> the component that shows it, and that which also sets it.
COMPONENTS: dict[Kind, tuple[str, str]] = {
    "states": ("sensor", "select"),
    "flag": ("binary_sensor", "switch"),
    "number": ("sensor", "number"),
    "time": ("sensor", "sensor"),
    "text": ("sensor", "text"),
}

READ_ONLY = ("sensor", "binary_sensor")

COMMAND = "{{ value | tojson }}"


class ValuePart(NamedTuple):
    """A value, or an item or a named bit of it: where it is in the value, and its kind."""

    name: str
    place: str
    kind: Kind


def _parts(point: Point) -> Iterator[ValuePart]:
    """Yield the parts of the value of a point; the value itself if it has none."""
    is_list = point.count > 1
    items = [(f"{at}", f"[{at}]") for at in range(point.count)] if is_list else [("", "")]
    kind, flags = point.read.kind, 0
    if kind is not None and kind.name.startswith("bits") and not point.is_part:
        flags = 16 * kind.registers
    for name, place in items:
        for bit, bits in point.meaning.bits.items():
            of_bit: Kind = "flag" if bits.is_flag else "number"
            yield ValuePart(f"{name} {bit}".strip(), f"{place}[{_quoted(bit)}]", of_bit)
        for at in range(flags):
            yield ValuePart(f"{name} {at}".strip(), f"{place}[{at}]", "flag")
        if not (flags or point.meaning.bits):
            yield ValuePart(name, place, _kind(point))


def _kind(point: Point) -> Kind:
    kind, part = point.read.kind, point.meaning.part
    if point.states:
        return "states"
    if kind is None or (part is not None and part.is_flag):
        return "flag"
    if point.meaning.has_numbers:
        return "number"
    return "time" if kind.is_time else "text"


def _quoted(name: str) -> str:
    """Return a name as a string in a template."""
    return json.dumps(name, ensure_ascii=False)


def _component(
    point: Point, part: ValuePart, value: str, *, is_set: bool
) -> tuple[str, dict[str, Any]]:
    """Return the component of a part, and the keys that it has because of its kind."""
    shows, sets = COMPONENTS[part.kind]
    low, high = _bounds(point)
    is_set = is_set and not part.place and (part.kind != "number" or low < high)
    component = sets if is_set else shows
    if value and part.place:
        value = f"{value} and {value}{part.place}"
    if value and part.kind == "states":  # a number without a name is no option
        value = f"({value}) if ({value}) is string else None"
    keys: dict[str, Any] = {"value_template": f"{{{{ {value} }}}}"} if value else {}
    match component, part.kind:
        case "sensor", "states":
            keys |= {"device_class": "enum", "options": _options(point)}
        case "select", _:
            keys |= {"options": _options(point), "command_template": COMMAND}
        case "binary_sensor", _:
            keys |= {"payload_on": "True", "payload_off": "False"}
        case "switch", _:
            keys |= {"payload_on": "true", "payload_off": "false"}
            if value:
                keys |= {"state_on": "True", "state_off": "False"}
        case "sensor", "number":
            keys |= _units(point)
            keys["state_class"] = _state_class(point, keys.get("device_class"))
        case "number", _:
            step = max(point.step, SMALLEST_STEP)
            keys |= {**_units(point), "min": low, "max": high, "step": step}
        case "sensor", "time":
            keys["device_class"] = "timestamp"
        case "text", _:
            longest = min(2 * len(point.cells), LONGEST_TEXT)
            keys |= {"max": longest, "command_template": COMMAND}
    return component, keys


def _options(point: Point) -> list[str]:
    return [*dict.fromkeys((point.states or {}).values())]


def _bounds(point: Point) -> tuple[float, float]:
    low, high = point.limits
    low, high = WIDEST if low is None or high is None else (low, high)
    return (
        low if point.minimum is None else point.minimum,
        high if point.maximum is None else point.maximum,
    )


def _units(point: Point) -> dict[str, str]:
    if not point.units:
        return {}
    unit = SPELLINGS.get(point.units, point.units)
    keys = {"unit_of_measurement": unit}
    return keys | ({"device_class": CLASS_OF[unit]} if unit in CLASS_OF else {})


def _state_class(point: Point, device_class: str | None) -> str:
    if point.never_falls and device_class in RISING:
        return "total_increasing"
    return "total" if device_class in AMOUNTS else "measurement"
