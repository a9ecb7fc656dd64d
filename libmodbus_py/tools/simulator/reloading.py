"""
A device file that is read again while its devices are served.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
from collections.abc import Callable, Iterable, Sequence

from ...protocol.mistakes import inside
from ..faults.server import Server
from ..files.texts import compared, reread
from .device_file import load
from .simulated import SimulatedDevice, Simulation

__all__ = ["Reloader"]

LOOK_EVERY_S = 0.5
"""Two checks of the files in a row must see the same, because writing a file takes a while."""

# The attributes that change when a file is written or replaced.
Signature = tuple[int, int, int] | None


class Reloader:
    """
    Reads a device file again when it is asked to, or when the file or a register map of it changes.

    The file is read in a thread, so clients are answered meanwhile, and their connections stay. A
    mistake in the file leaves the devices as they were. See `Simulation.going_on_from` for the fate
    of values that clients wrote.

    Args:
        server: the server of `simulation`.
        path: path of the file.
        is_watching: True to check the files for changes.
        tell: called in the loop of the server with one line about each reading, or mistake.
    """

    def __init__(
        self,
        server: Server,
        path: str,
        simulation: Simulation,
        *,
        is_watching: bool,
        tell: Callable[[str], object],
    ) -> None:
        self._server = server
        self._path = path
        self._simulation = simulation
        self._look_every = LOOK_EVERY_S if is_watching else None
        self._tell = tell
        self._asked = asyncio.Event()
        self._of_others: Sequence[str] = ()
        self._files = (path, *simulation.files)
        self._read_signatures = self._signatures()

    @property
    def devices(self) -> SimulatedDevice | dict[int, SimulatedDevice]:
        """The devices that are served, with the values that they took over."""
        return self._simulation.devices

    def start(self) -> None:
        """Begin, in the loop of the server; `close` or the end of the loop ends it."""
        self._task = asyncio.get_running_loop().create_task(self._run())

    def close(self) -> None:
        """Read the file no more; in the loop of the server."""
        self._task.cancel()

    def ask(self, of_others: Sequence[str] = ()) -> None:
        """
        Request another reading of the file, in the loop of the server.

        Args:
            of_others: what the line about this reading says of other files.
        """
        self._of_others = of_others
        self._asked.set()

    async def _run(self) -> None:
        seen = self._read_signatures
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._look_every):
                    await self._asked.wait()
            is_asked = self._asked.is_set()
            self._asked.clear()
            before, seen = seen, self._signatures()
            if is_asked or seen == before != self._read_signatures:
                await self._read_again()
                seen = self._read_signatures

    async def _read_again(self) -> None:
        self._read_signatures = self._signatures()
        loading = asyncio.get_running_loop().run_in_executor(None, load, self._path)
        try:
            await asyncio.wait([loading])
        finally:
            loading.cancel()  # if this task was cancelled, its result is not used
        error = loading.exception()
        self._follow(getattr(error, "files", ()) if error else loading.result().files)
        line = reread(loading.result, self._use)
        of_others, self._of_others = self._of_others, ()
        self._tell("; ".join([line, *of_others]))
        gc.collect()  # old devices are reference cycles, and their tables larger than they look

    def _use(self, simulation: Simulation) -> str:
        # Before values are taken over, because nothing may change if the file cannot be served.
        with inside(self._path):
            self._server.replace(*simulation)
        before = self._simulation
        self._simulation = simulation.going_on_from(before)
        self._server.replace(*self._simulation)
        changes = compared(self._path, "unit", before.by_unit, self._simulation.by_unit)
        of_faults = "" if before.faults == simulation.faults else "; its faults have changed"
        return changes + of_faults

    # --- the files -----------------------------------------------------------------------------

    def _follow(self, maps: Iterable[str]) -> None:
        """Watch these maps from now on; new maps count as unchanged since they were just read."""
        self._files = (self._path, *maps)
        known = self._read_signatures
        self._read_signatures = {
            path: known[path] if path in known else _signature(path) for path in self._files
        }

    def _signatures(self) -> dict[str, Signature]:
        return {path: _signature(path) for path in self._files}


def _signature(path: str) -> Signature:
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
