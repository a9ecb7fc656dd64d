"""
Readings as JSON and CSV.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable
from functools import lru_cache
from typing import Any

from ....protocol.plain import plain
from ..readings import Reading, time_text

__all__ = ["as_csv", "as_json", "payload"]

_encode = json.JSONEncoder(ensure_ascii=False).encode

_quoted = json.encoder.encode_basestring

_time_text = lru_cache(maxsize=64)(time_text)  # all readings of a poll have the same time


def payload(reading: Reading) -> dict[str, Any]:
    """Return a reading as an object for JSON, without the names of the device and the point."""
    told = {
        "time": time_text(reading.time),
        "value": plain(reading.value),
        "unit": reading.unit,
        "quality": reading.quality,
    }
    return {**told, "reason": reading.reason} if reading.reason else told


def as_json(readings: Iterable[Reading]) -> bytes:
    """Return a line of JSON for each reading."""
    # Formatted directly, because dictionaries are too slow for 40000 readings a second.
    lines = [
        f'{{"device": {_quoted(device)}, "name": {_quoted(name)}, "time": "{_time_text(time)}",'
        f' "value": {_number(value)}, "unit": {_quoted(unit)}, "quality": "{quality}"'
        + (f', "reason": {_quoted(reason)}}}\n' if reason else "}\n")
        for time, device, name, value, unit, quality, reason in readings
    ]
    return "".join(lines).encode()


def _number(value: Any) -> str:
    return repr(value) if type(value) is int else _encode(plain(value))


def as_csv(readings: Iterable[Reading]) -> bytes:
    """Return a row of CSV for each reading, with the fields of `Reading` in their order."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    for each in readings:
        value = json.dumps(plain(each.value)) if isinstance(each.value, list) else each.value
        writer.writerow((_time_text(each.time), *each[1:3], value, *each[4:]))
    return text.getvalue().encode()
