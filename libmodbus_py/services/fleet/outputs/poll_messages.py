"""
Messages in JSON with the readings of a device: ``{"device": ..., "values": {NAME: {...}}}``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from ....protocol.json_text import JSON
from ..readings import Reading
from .forms import payload_text
from .output import ReadingsRefused

__all__ = ["poll_messages"]

FRAME = 70
"""More than the bytes of the keys of a message, and of the numbers of parts."""

_json = JSON.encode


def poll_messages(
    device: str, readings: Iterable[Reading], largest: int, labels: Mapping[str, str]
) -> Iterator[tuple[list[str], bytes]]:
    """
    Yield the names in each message with these readings of a device, and its data.

    Several messages also have ``"part": 1, "parts": 3``.

    Args:
        largest: the bytes that the data of a message may have.
        labels: of the device.

    Raises:
        ReadingsRefused: a single reading has more bytes.
    """
    values = {each.name: f"{_json(each.name)}: {payload_text(each)}" for each in readings}
    begin = f'{{"device": {_json(device)}, '
    if labels:
        begin += f'"labels": {_json(dict(labels))}, '
    longest = max(len(name.encode()) for name in values)
    parts = list(_parts(values, largest - FRAME - 2 * len(begin.encode()) - longest))
    for at, names in enumerate(parts):
        part = f'"part": {at + 1}, "parts": {len(parts)}, ' if len(parts) > 1 else ""
        told = ", ".join([values[name] for name in names])
        yield names, f'{begin}{part}"values": {{{told}}}}}'.encode()


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
