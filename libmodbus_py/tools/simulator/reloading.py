"""
A device file that is read again while its devices are served.

A thread reads it, so clients are answered meanwhile, and their connections stay. A mistake leaves
the devices as they were. `tell` is called in the server's loop with a line about each reading.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
from collections.abc import Callable, Sequence

from ...files.texts import compared, reread
from ...protocol.mistakes import inside
from ...server.server import Server
from .device_file import load
from .hooks_file import HooksFile
from .simulated import Simulation

LOOK_EVERY_S = 0.5
"""Two checks of the files in a row must see the same, because writing a file takes a while."""


class Reloader:
    """Reads a device file again when asked to, or when it or one of its maps changes."""

    def __init__(
        self,
        server: Server,
        path: str,
        simulation: Simulation,
        *,
        is_watching: bool,
        tell: Callable[[Sequence[str]], object],
        hooks: HooksFile | None = None,
    ) -> None:
        self._server = server
        self._path = path
        self._simulation = simulation
        self._look_every = LOOK_EVERY_S if is_watching else None
        self._tell = tell
        self._hooks = hooks
        self._demand = asyncio.Event()
        self._of_others: Sequence[str] = ()
        self._maps: Sequence[str] = simulation.files
        self._read = self._signatures()

    def start(self) -> None:
        """Begin, in the loop of the server; `close` or the end of the loop ends it."""
        self._task = asyncio.get_running_loop().create_task(self._run())

    def close(self) -> None:
        """Read the file no more; in the loop of the server."""
        self._task.cancel()

    def ask(self, of_others: Sequence[str] = ()) -> None:
        """Read the file again, in the server's loop; `of_others`: lines about other files."""
        self._of_others = of_others
        self._demand.set()

    async def _run(self) -> None:
        signatures = self._read
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._look_every):
                    await self._demand.wait()
            is_asked = self._demand.is_set()
            self._demand.clear()
            before, signatures = signatures, self._signatures()
            if is_asked or signatures == before != self._read:
                await self._read_again()
                signatures = self._read

    async def _read_again(self) -> None:
        before = self._signatures()
        loading = asyncio.get_running_loop().run_in_executor(None, load, self._path)
        try:
            await asyncio.wait([loading])
        finally:
            loading.cancel()  # if this task was cancelled, its result is not used
        self._maps = getattr(loading.exception() or loading.result(), "files", ())
        now = self._signatures()
        self._read = {path: before.get(path, facts) for path, facts in now.items()}
        line = reread(loading.result, self._use)
        of_others, self._of_others = self._of_others, ()
        self._tell([line, *of_others])
        gc.collect()  # old devices are reference cycles, and their tables larger than they look

    def _use(self, simulation: Simulation) -> str:
        # Before values are taken over, because nothing may change if the file cannot be served.
        with inside(self._path):
            self._server.check_devices(simulation.devices)
        before = self._simulation
        self._simulation = simulation.with_state_of(before)
        if self._hooks is not None:
            self._hooks.use(self._simulation.devices)
        self._server.replace(self._simulation.devices, faults=self._simulation.faults)
        changes = compared(self._path, "unit", before.by_unit, self._simulation.by_unit)
        of_faults = "" if before.faults == simulation.faults else "; its faults have changed"
        return changes + of_faults

    def _signatures(self) -> dict[str, tuple[int, ...]]:
        """Return what changes of the files when they are written or replaced, by path."""
        signatures: dict[str, tuple[int, ...]] = {}
        for path in (self._path, *self._maps):
            signatures[path] = ()
            with contextlib.suppress(OSError, ValueError):
                facts = os.stat(path)
                signatures[path] = facts.st_mtime_ns, facts.st_size, facts.st_ino
        return signatures
