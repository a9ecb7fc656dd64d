"""
Values of points with `rewrite`, which are written again every so many seconds after a write: some
devices fall back to a value of their own when no master repeats the last one.

A new write ends the repetition of the value before it first, so that this never follows the new
one; if the new one fails, the value before it is repeated again. A repetition that fails is logged,
and comes again after the same time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from ...maps.register_map import RegisterMap
from ...protocol.errors import ModbusError
from ...protocol.logs import HarmlessLogger
from ..tasks import KeptTasks

logger: HarmlessLogger = HarmlessLogger(__name__)


class Rewrites:
    """
    The repeated values of one device.

    Args:
        device: the name of the device, for the log.
        points: its points.
        send: writes values by name.
        tasks: keeps the tasks that wait.
    """

    def __init__(
        self,
        device: str,
        points: RegisterMap,
        send: Callable[[Mapping[str, Any]], Awaitable[None]],
        tasks: KeptTasks,
    ) -> None:
        self._device = device
        self._points = points
        self._send = send
        self._tasks = tasks
        self._repeated: dict[str, tuple[Any, asyncio.Task[None]]] = {}

    async def write(self, values: Mapping[str, Any]) -> None:
        """Write values, and repeat those of points with `rewrite`."""
        before = {name: self._end(name) for name in self._repeated.keys() & values.keys()}
        try:
            await self._send(values)
        except BaseException:
            self._begin({name: before[name] for name in before.keys() - self._repeated.keys()})
            raise
        for name in self._repeated.keys() & values.keys():  # of another write at the same time
            self._end(name)
        self._begin(values)

    def end(self) -> None:
        for name in list(self._repeated):
            self._end(name)

    def _begin(self, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            if (seconds := self._points[name].rewrite) is not None:
                task = self._tasks.begin(self._repeat(name, value, seconds))
                self._repeated[name] = value, task

    def _end(self, name: str) -> Any:
        value, task = self._repeated.pop(name)
        task.cancel()
        return value

    async def _repeat(self, name: str, value: Any, seconds: float) -> None:
        while True:
            await asyncio.sleep(seconds)
            try:
                await self._send({name: value})
            except (ModbusError, ValueError) as error:
                logger.warning("%s: %s was not written again: %s", self._device, name, error)
