"""Writes to named points that are received over an output, and their outcomes, both in JSON."""

from __future__ import annotations

import asyncio
import json
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol
from weakref import WeakValueDictionary

from ...protocol.errors import ModbusError
from ...protocol.json_text import JSON, each_once
from ...protocol.logs import HarmlessLogger
from ...protocol.mistakes import WrongValue
from ...protocol.plain import time_text
from .statistics import FleetStatistics

logger: HarmlessLogger = HarmlessLogger(__name__)

MOST_AT_ONCE = 32
"""More writes at once are refused: a flood must neither stop polling nor fill the memory."""

LONGEST_BYTES = 4096
"""The length of a command; a list of 125 registers is shorter."""


class _Command(NamedTuple):
    """A command: the value, its id, which the outcome repeats, and why it is invalid, if it is."""

    value: Any = None
    id: str | int | None = None
    problem: str = ""


def command_of(data: bytes) -> _Command:
    """Read a command: a value in JSON, or an object with `value` and optionally `id`."""
    if len(data) > LONGEST_BYTES:
        return _Command(problem=f"it must have at most {LONGEST_BYTES} bytes, not {len(data)}")
    try:
        content = json.loads(data.decode(), object_pairs_hook=each_once)
        # Refuses nan and infinity, and characters that no text can contain, but escapes can name.
        JSON.encode(content).encode()
    except WrongValue as error:
        return _Command(problem=f"{error} in its JSON")
    except (ValueError, RecursionError):
        return _Command(problem=f"it must be a value in JSON, not {data[:40]!r}")
    if not isinstance(content, dict):
        return _Command(content)
    number = content.get("id")
    if not content.keys() <= {"value", "id"} or "value" not in content:
        return _Command(problem="an object must have a value, and may have an id")
    if not isinstance(number, str | int | None) or len(str(number)[:101]) > 100:
        return _Command(problem="id must be text or a number, of at most 100 characters")
    return _Command(content["value"], number)


class Writing(Protocol):
    """What commands need of a `Fleet`: writes to points of devices, by name."""

    statistics: FleetStatistics

    def unknown(self, device: str, point: str) -> str: ...

    async def write(self, device: str, values: dict[str, Any]) -> None: ...


class Commands:
    """
    Carries out writes and returns their outcomes.

    Writes to one device are carried out in the order in which they came, each after the last
    attempt of the one before.
    """

    def __init__(self, fleet: Writing) -> None:
        # Returns why commands to a device are refused; None if they are carried out here, and "" if
        # they are answered elsewhere.
        self.refusal: Callable[[str], str | None] = lambda device: None
        self._fleet = fleet
        self._count = 0
        # One for each device that is written to.
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    async def answer(self, device: str, name: str, payload: bytes) -> bytes | None:
        """Write a value; return the outcome, None if the command is answered elsewhere."""
        command = command_of(payload)
        problem = self._problem(device, name, command)
        if problem == "":
            problem = await self._in_turn(device, name, command)
        if problem is None:
            return None
        statistics = self._fleet.statistics
        statistics.commands += not problem
        statistics.refused_commands += bool(problem)
        logger.info("%s: %s = %r: %s", device, name, command.value, problem or "written")
        outcome: dict[str, Any] = {"ok": not problem, "time": time_text(time.time())}
        if command.id is not None:
            outcome["id"] = command.id
        if problem:
            outcome["error"] = problem
        return JSON.encode(outcome).encode(errors="backslashreplace")

    def _problem(self, device: str, name: str, command: _Command) -> str | None:
        """Return why a command is refused; "" if it is not, None if it is answered elsewhere."""
        refusal = self.refusal(device)
        if refusal is not None:
            return refusal or None
        return command.problem or self._fleet.unknown(device, name)

    async def _in_turn(self, device: str, name: str, command: _Command) -> str | None:
        """Write a value after those that came before; return as `_problem`."""
        if self._count >= MOST_AT_ONCE:
            return f"{MOST_AT_ONCE} writes are already under way"
        self._count += 1
        try:
            async with self._turns.setdefault(device, asyncio.Lock()):
                # The device may have gone while this waited.
                problem = self._problem(device, name, command)
                if problem == "":
                    await self._fleet.write(device, {name: command.value})
                return problem
        except (TypeError, ValueError, ModbusError, OverflowError) as error:
            return str(error)
        finally:
            self._count -= 1
