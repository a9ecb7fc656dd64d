"""
A device file that is read again while its devices are served.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import threading
from collections.abc import Callable

from ..faults.server import Server
from ..files.texts import reread
from .device_file import load
from .simulated import SimulatedDevice, Simulation

__all__ = ["Reloader"]

# Seconds between two checks of the files. Two checks in a row must see the same, because
# writing a file takes a while.
LOOK_EVERY = 0.5

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
        tell: called in the thread with one line about each reading, or mistake.
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
        self._is_watching = is_watching
        self._tell = tell
        self._loop: asyncio.AbstractEventLoop | None = None
        self._asked = threading.Event()
        self._is_closed = False
        self._thread = threading.Thread(target=self._run, name="device file", daemon=True)
        self._files = (path, *simulation.files)
        self._read_signatures = self._signatures()

    @property
    def devices(self) -> SimulatedDevice | dict[int, SimulatedDevice]:
        """The devices that are served, with the values that they took over."""
        return self._simulation.devices

    def start(self) -> None:
        """Start the thread; call it in the loop of the server."""
        self._loop = asyncio.get_running_loop()
        self._thread.start()

    def ask(self) -> None:
        """Request another reading of the file; from any thread or a signal handler of the loop."""
        self._asked.set()

    def close(self) -> None:
        """Stop the thread; any number of times, and also if it was never started."""
        self._is_closed = True
        self._asked.set()
        if self._thread.ident is not None:
            self._thread.join()

    # --- in the thread -------------------------------------------------------------------------

    def _run(self) -> None:
        seen = self._read_signatures
        while True:
            is_asked = self._asked.wait(LOOK_EVERY if self._is_watching else None)
            if self._is_closed:
                return
            self._asked.clear()
            before, seen = seen, self._signatures()
            if is_asked or seen == before != self._read_signatures:
                self._read_again()
                seen = self._read_signatures

    def _signatures(self) -> dict[str, Signature]:
        return {path: _signature(path) for path in self._files}

    def _read_again(self) -> None:
        self._read_signatures = self._signatures()
        reread(self._load, self._exchanged, self._tell)
        gc.collect()  # old devices are reference cycles, and their tables larger than they look

    def _load(self) -> Simulation:
        try:
            simulation = load(self._path)
        except ValueError as error:
            self._follow(getattr(error, "files", ()))
            raise
        self._follow(simulation.files)
        return simulation

    def _follow(self, maps: tuple[str, ...]) -> None:
        """Watch these maps from now on; new maps count as unchanged since they were just read."""
        self._files = (self._path, *maps)
        known = self._read_signatures
        self._read_signatures = {
            path: known[path] if path in known else _signature(path) for path in self._files
        }

    def _exchanged(self, simulation: Simulation) -> list[str]:
        """Serve the new devices, from within the event loop, so that no client can write."""
        done = threading.Event()
        outcome: list[str] = []

        def exchange() -> None:
            nonlocal outcome
            try:
                outcome = [self._exchange(simulation)]
            finally:
                done.set()

        assert self._loop is not None
        with contextlib.suppress(RuntimeError):
            self._loop.call_soon_threadsafe(exchange)
            while not done.wait(0.1):
                if self._is_closed:
                    return []
        return outcome

    # --- in the loop ---------------------------------------------------------------------------

    def _exchange(self, simulation: Simulation) -> str:
        try:
            # Before values are taken over, because nothing may change if the file cannot be served.
            self._server.replace(*simulation)
        except ValueError as error:
            return f"nothing is changed: {self._path}: {error}"
        self._simulation = simulation.going_on_from(self._simulation)
        self._server.replace(*self._simulation)
        devices = self._simulation.devices
        count = len(devices) if isinstance(devices, dict) else 1
        return f"{self._path}: read again, {count} unit{'s' * (count != 1)}"


def _signature(path: str) -> Signature:
    try:
        found = os.stat(path)
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino
