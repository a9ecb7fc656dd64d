"""
Messages in JSON with the readings of a device: ``{"device": ..., "values": {NAME: {...}}}``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from ....protocol.plain import JSON
from ..readings import Reading
from .forms import object_text
from .output import ReadingsRefused

__all__ = ["newest", "poll_messages"]

FRAME = 70
"""More than the bytes of the keys of a message, and of the numbers of parts."""

_json = JSON.encode


def poll_messages(readings: Sequence[Reading], largest: int) -> Iterator[tuple[list[str], bytes]]:
    """
    Yield the names in each message with these readings of a device, and its data.

    Several messages also have ``"part": 1, "parts": 3``.

    Args:
        readings: of one device, at least one; the newest one has its labels.
        largest: the bytes that the data of a message may have.

    Raises:
        ReadingsRefused: a single reading has more bytes.
    """
    device, labels = readings[0].device, newest(readings).labels
    values = {
        each.name: f"{_json(each.name)}: {object_text(each, with_labels=False)}"
        for each in readings
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


def newest(readings: Sequence[Reading]) -> Reading:
    """Return the reading with the greatest time."""
    return max(readings, key=lambda each: each.time)


def _parts(values: Mapping[str, str], room: int) -> Iterator[list[str]]:
    """Yield the names of the values of each message."""
    names: list[str] = []
    used = 0
    for name, text in values.items():
        size = len(text.encode()) + len(", ")
        if size > room:
            raise ReadingsRefused(f"{name}: the server takes no message of {size} bytes")
        if used + size > room:
            yield names
            names, used = [], 0
        names.append(name)
        used += size
    yield names
