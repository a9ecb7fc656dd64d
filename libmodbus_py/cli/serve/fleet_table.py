"""
The devices of a fleet that are down, and its values, as lines for a terminal.
"""

from __future__ import annotations

from collections.abc import Iterator

from ...protocol.plain import clock_text
from ...services.fleet.fleet import Fleet
from ...services.fleet.poller import DeviceState
from ...services.fleet.statistics import KeptReadings

__all__ = ["fleet_lines"]

MOST_LINES = 500
"""More than a terminal shows."""

WIDEST = 30
"""Characters of a name."""

MAX_TEXT_CHARACTERS = 60
"""Of a value, so that its unit of measurement stays on the line."""


def fleet_lines(fleet: Fleet, kept: KeptReadings, title: str) -> list[tuple[str, bool]]:
    """
    Return the title, the devices that are down, since when and why, and the values.

    Returns:
        Each line with True if it is bold.
    """
    lines = [(title, True), *((line, False) for line in _down(fleet))]
    readings = list(kept.by_name.copy().values())
    shown = [each for each in readings if each.quality != "down"][:MOST_LINES]
    device = min(max((len(each.device) for each in shown), default=0), WIDEST)
    name = min(max((len(each.name) for each in shown), default=0), WIDEST)
    for each in shown:
        text = (
            _text(each.value)[:MAX_TEXT_CHARACTERS]
            if each.quality == "good"
            else f"- ({each.reason})"
        )
        where = f"{each.device[:WIDEST]:<{device}}  {each.name[:WIDEST]:<{name}}"
        lines.append((f"{where}  {text:>14} {each.unit}".rstrip(), False))
    hidden = len(readings) - len(shown)
    return [*lines, (f"... {hidden} more", False)] if hidden > MOST_LINES else lines


def _down(fleet: Fleet) -> Iterator[str]:
    for each in fleet.devices.values():
        if each.state is DeviceState.DOWN:
            clock = clock_text(each.since)
            why = str(each.error).rpartition("): ")[2]
            yield f"{each.name[:WIDEST]} is down since {clock}: {why}"


def _text(value: object) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    text = str(value)
    return f"{value:.7g}" if isinstance(value, float) and len(text) > 12 else text
