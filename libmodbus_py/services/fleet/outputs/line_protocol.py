"""
Readings in the line protocol of InfluxDB.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from typing import Any

from ....protocol.mistakes import WrongType, WrongValue
from ....protocol.plain import plain, without_controls
from ..config import DeviceConfig
from ..readings import Reading
from .line_file import Format

__all__ = ["LineProtocol"]

_MEASUREMENT = re.compile(r"([, ])")

_KEY = re.compile(r"([,= ])")

RESERVED = ("time", "_time", "_measurement", "_field", "_value", "_start", "_stop")
"""Keys that InfluxDB 1 and 2 use themselves: points and labels of these names get a "_" behind."""


class LineProtocol:
    """
    Writes a line for each poll of a device: the tags are the device and its labels, and each point
    is a field.

    ``modbus,device=north,site=Halle voltage=230.5,power=1200 1700000000000000000``

    Numbers are floats, because a field has one type for good in InfluxDB, and scaled values are
    whole numbers now and then. A point with named states is text, also a number without a name.
    Items of lists and named bits are fields of their own, such as ``flags.door``. A point without a
    value has the fields ``NAME.quality`` and ``NAME.reason`` in its place.

    Source: the line protocol of InfluxDB 1.x and 2.x.
    """

    def __init__(self, measurement: str) -> None:
        self._measurement = _MEASUREMENT.sub(r"\\\1", _name("measurement", measurement))
        # Device -> its points whose values are text, also of devices that were removed.
        self._texts: dict[str, frozenset[str]] = {}

    @property
    def format(self) -> Format:
        """The format of a file with these lines."""
        return Format("influx", self.lines, f"{self._measurement},".encode())

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Set the devices of the readings, by their names."""
        self._texts |= {
            name: frozenset(point for point in each.map if each.map[point].states is not None)
            for name, each in devices.items()
        }

    def lines(self, readings: Iterable[Reading]) -> bytes:
        """Return the lines of readings, in UTF-8; times are in nanoseconds."""
        return "".join(
            f"{self._head(poll[0].device, poll[0].labels)} {','.join(fields)}"
            f" {round(poll[0].time * 1e6) * 1000}\n"
            for poll in [list(group) for _, group in groupby(readings, lambda each: each.poll)]
            if (fields := [field for each in poll for field in self._fields(each)])
        ).encode()

    def _head(self, device: str, labels: Mapping[str, str]) -> str:
        tags = {"device": device, **labels}
        # InfluxDB recommends tags in order; a tag without a value is not a tag.
        parts = [f"{_key(name)}={_spelled(tags[name])}" for name in sorted(tags) if tags[name]]
        return ",".join((self._measurement, *parts))

    def _fields(self, reading: Reading) -> Iterator[str]:
        name = reading.name
        if reading.value is None:
            yield f"{_key(f'{name}.quality')}={_text(reading.quality)}"
        elif name in self._texts.get(reading.device, ()):
            yield f"{_key(name)}={_text(str(reading.value))}"
        else:
            yield from _values(name, reading.value)
        if reading.reason:
            yield f"{_key(f'{name}.reason')}={_text(reading.reason)}"


def _values(name: str, value: Any) -> Iterator[str]:
    """Yield the fields of a value."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _values(f"{name}.{key}", each)
    elif isinstance(value, list | tuple):
        for at, each in enumerate(value):
            yield from _values(f"{name}.{at}", each)
    elif value is not None and not (isinstance(value, float) and not math.isfinite(value)):
        yield f"{_key(name)}={_field(value)}"


def _field(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, int | float) else _text(str(plain(value)))


def _text(text: str) -> str:
    """Return text as a field, in one line."""
    escaped = without_controls(text).replace("\n", "\\x0a").replace("\\", "\\\\")
    return '"' + escaped.replace('"', '\\"') + '"'


def _key(name: str) -> str:
    return _spelled(f"{name}_" if name in RESERVED else name)


def _spelled(name: str) -> str:
    # A backslash cannot be escaped, and would escape the character behind it.
    escaped = without_controls(name).replace("\n", "%0A").replace("\\", "%5C")
    return _KEY.sub(r"\\\1", escaped)


def _name(key: str, name: object) -> str:
    if not isinstance(name, str):
        raise WrongType(key, f"must be text, not {type(name).__name__}")
    is_written = 1 <= len(name) <= 200 and name.isprintable() and "\\" not in name
    if not is_written or name.startswith(("_", "#")):
        allowed = "1 to 200 printable characters without \\, the first neither _ nor #"
        raise WrongValue(key, f"must be {allowed}, not {name[:50]!r}")
    return name
