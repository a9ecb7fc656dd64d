"""Readings as JSON and CSV, and messages in JSON with the readings of a poll."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import lru_cache
from math import isfinite
from typing import Any

from ....files.csv_text import csv_rows
from ....protocol.json_text import JSON, json_text
from ....protocol.plain import plain, time_text
from ..readings import Reading
from .output import ReadingsRefused

COLUMNS: tuple[str, ...] = "time", "device", "name", "value", "unit", "quality", "reason"
"""The columns of CSV: what a reading has, but for its id and its labels."""

_json = JSON.encode

_C1 = re.compile(r"[\x7f-\x9f]")

_quoted = json.encoder.encode_basestring

_time_text = lru_cache(maxsize=64)(time_text)  # all readings of a poll have the same time


def object_text(reading: Reading, *, with_labels: bool = True) -> str:
    """Return a reading as an object of JSON, without the names of the device and of the point."""
    return "{" + _fields(reading, with_labels)


def as_json(readings: Iterable[Reading]) -> bytes:
    text = "".join(
        f'{{"device": {_quoted(row.device)}, "name": {_quoted(row.name)}, {_fields(row)}\n'
        for row in readings
    )
    # The encoder escapes the other control characters.
    return _C1.sub(lambda match: f"\\u{ord(match[0]):04x}", text).encode()


def _fields(reading: Reading, with_labels: bool = True) -> str:
    """Return the end of an object of JSON, formatted here, because `json` is too slow."""
    time, _, _, value, units, quality, reason, number, labels = reading
    return (
        f'"time": "{_time_text(time)}", "value": {_number(value)}, "unit": {_quoted(units)},'
        f' "quality": "{quality}"'
        + (f', "reason": {_quoted(reason)}' if reason else "")
        + (f', "id": {number}' if number else "")
        + (f', "labels": {_json(dict(labels))}}}' if labels and with_labels else "}")
    )


def _number(value: Any) -> str:
    if type(value) is int or (type(value) is float and isfinite(value)):
        return repr(value)
    return _json(plain(value))


def _cell(value: Any) -> Any:
    """Return a value for CSV: numbers and text as they are, all else as in JSON."""
    return json_text(plain(value)) if isinstance(value, list | dict) else plain(value)


def as_csv(readings: Iterable[Reading], labels: Sequence[str] = ()) -> bytes:
    """Return a row of CSV for each reading: `COLUMNS`, and a cell for each of these labels."""
    rows = [
        (
            _time_text(time),
            device,
            name,
            _cell(value),
            *others,
            *[own_labels.get(key, "") for key in labels],
        )
        for time, device, name, value, *others, _, own_labels in readings
    ]
    return csv_rows(rows).encode()


FRAME = 70
"""More than the bytes of the keys of a message, and of the numbers of parts."""


def poll_messages(readings: Sequence[Reading], largest: int) -> Iterator[tuple[list[str], bytes]]:
    """
    Yield the names in each message with these readings of a device, and its data; ReadingsRefused
    if one has more than `largest` bytes. Several messages also have ``"part": 1, "parts": 3``.
    """
    device, labels = readings[0].device, readings[-1].labels
    values = {
        reading.name: f"{_json(reading.name)}: {object_text(reading, with_labels=False)}"
        for reading in readings
    }
    begin = f'{{"device": {_json(device)}, '
    if labels:
        begin += f'"labels": {_json(dict(labels))}, '
    longest = max(len(name.encode()) for name in values)
    parts = list(_parts(values, largest - FRAME - 2 * len(begin.encode()) - longest))
    for at, names in enumerate(parts):
        part = f'"part": {at + 1}, "parts": {len(parts)}, ' if len(parts) > 1 else ""
        texts = ", ".join([values[name] for name in names])
        yield names, f'{begin}{part}"values": {{{texts}}}}}'.encode()


def _parts(values: Mapping[str, str], room: int) -> Iterator[list[str]]:
    """Yield the names of the values of each message."""
    names: list[str] = []
    length = 0
    for name, text in values.items():
        size = len(text.encode()) + len(", ")
        if size > room:
            raise ReadingsRefused(f"{name}: the server takes no message of {size} bytes")
        if length + size > room:
            yield names
            names, length = [], 0
        names.append(name)
        length += size
    yield names
