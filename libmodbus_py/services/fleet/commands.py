"""
Writes to named points that are received over an output, and their outcomes.
"""

from __future__ import annotations

import json
import logging
import time
from typing import Any, NamedTuple, Protocol

from ...protocol.errors import ModbusError
from .readings import time_text
from .statistics import FleetStatistics

__all__ = ["Commands", "Wanted", "Writing", "wanted_of"]

logger: logging.Logger = logging.getLogger(__name__)

# More writes at once are refused: a flood must neither stop polling nor fill the memory.
MOST_AT_ONCE = 32

# Bytes of a command; a list of 125 registers is smaller.
LONGEST = 4096


class Wanted(NamedTuple):
    """
    A received command.

    Attributes:
        value: the value to write.
        id: repeated in the outcome, so that a sender recognizes it; None without one.
        problem: the reason why the command is invalid; empty if it is valid.
    """

    value: Any = None
    id: str | int | None = None
    problem: str = ""


def wanted_of(data: bytes) -> Wanted:
    """
    Read a command: a value in JSON (21.5, true, [1, 2], "text"), or an object with `value` and
    optionally `id`.
    """
    if len(data) > LONGEST:
        return Wanted(problem=f"it must have at most {LONGEST} bytes, not {len(data)}")
    try:
        content = json.loads(data)
    except (ValueError, RecursionError):
        return Wanted(problem=f"it must be a value in JSON, not {data[:40]!r}")
    if not isinstance(content, dict):
        return Wanted(content)
    number = content.get("id")
    if not content.keys() <= {"value", "id"} or "value" not in content:
        return Wanted(problem="an object must have a value, and may have an id")
    if not isinstance(number, str | int | None) or len(str(number)[:101]) > 100:
        return Wanted(problem="id must be text or a number, of at most 100 characters")
    return Wanted(content["value"], number)


class Writing(Protocol):
    """Writes to points of devices by name: a `Fleet`."""

    statistics: FleetStatistics

    async def write(self, device: str, values: dict[str, Any]) -> None: ...


class Commands:
    """
    Carries out writes and returns their outcomes: ``{"ok": true}``, or ``{"ok": false,
    "error": "setpoint: value must be in 10..30, not 99"}``, with the time.

    Values are checked against the access, the type and the range of the map before anything is
    sent. More than 32 writes at once are refused.

    Args:
        fleet: writes to the devices.
    """

    def __init__(self, fleet: Writing) -> None:
        self._fleet = fleet
        self._count = 0

    async def answer(self, device: str, name: str, wanted: Wanted) -> dict[str, Any]:
        """Write a value, and return the outcome as an object for JSON."""
        problem = await self._carry_out(device, name, wanted)
        statistics = self._fleet.statistics
        statistics.commands += not problem
        statistics.refused_commands += bool(problem)
        logger.info("%s: %s = %r: %s", device, name, wanted.value, problem or "written")
        outcome: dict[str, Any] = {"ok": not problem, "time": time_text(time.time())}
        if wanted.id is not None:
            outcome["id"] = wanted.id
        return {**outcome, "error": problem} if problem else outcome

    async def _carry_out(self, device: str, name: str, wanted: Wanted) -> str:
        if wanted.problem:
            return wanted.problem
        if self._count >= MOST_AT_ONCE:
            return f"{MOST_AT_ONCE} writes are already under way"
        self._count += 1
        try:
            await self._fleet.write(device, {name: wanted.value})
        except KeyError:
            return f"there is no device {device!r}"
        except (TypeError, ValueError, ModbusError, OverflowError) as error:
            return str(error)
        finally:
            self._count -= 1
        return ""
