"""
The file in which a server keeps the values of its devices, so that they survive a restart.

A second file, with the ending ".lock", is locked, so that no other program uses it.
"""

from __future__ import annotations

import errno
import os
import threading
import time
from collections.abc import Callable, Mapping

from ..device import state
from ..device.device import Device
from ..ports.port import abandoned_in_children
from ..protocol.logs import HarmlessLogger
from ..system import lock_file

logger: HarmlessLogger = HarmlessLogger(__name__)

# Seconds between two times of writing. `kill -9` may lose 0.5 s: the rest is for a slow disk. The
# pause is four times as long as the last time took, so that many large tables take a fifth of a
# processor at most: to look whether 247 full devices have changed takes 0.2 s.
WRITE_EVERY = 0.1

# Errors after which the devices are served all the same, and their values are not kept.
CANNOT_WRITE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT)


class StateFile:
    """Keeps the values of devices in a file while a server runs: a thread writes what changes."""

    def __init__(self, path: str, devices: Callable[[], Device | Mapping[int, Device]]) -> None:
        self._path = path
        self._devices = devices
        self._users = 0  # loops in which the server runs
        self._users_lock = threading.Lock()
        self._lock: int | None = None
        self._owner = os.getpid()
        self._is_failing = False
        self._is_closed = threading.Event()
        # Unit -> the device and a digest of its values, and their text, at the last time.
        self._units: dict[int | None, tuple[object, str]] = {}
        self._text: str | None = None
        abandoned_in_children(self)

    def __enter__(self) -> None:
        """
        Load the values, unless this file wrote them last; write the file, and keep it up to date.

        Raises:
            ValueError: the file cannot be used; no value was loaded.
        """
        with self._users_lock:
            if self._owner != os.getpid():
                self._users, self._owner = 0, os.getpid()
            if not self._users:
                try:
                    self._load()
                except BaseException as error:
                    self.abandon()
                    if isinstance(error, ValueError):
                        raise ValueError(f"state: {error}") from None
                    raise
                self._is_closed.clear()
                self._write()
                self._thread = threading.Thread(target=self._run, name="state file", daemon=True)
                self._thread.start()
            self._users += 1

    def __exit__(self, *_: object) -> None:
        """Write the file for the last time, and unlock it, at the end of the last block."""
        if self._owner != os.getpid():
            return
        with self._users_lock:
            self._users -= 1
            if not self._users:
                self._is_closed.set()
                self._thread.join()
                self._write()
                self.abandon()

    def abandon(self) -> None:
        """Close the lock without saving; in a forked child, the parent keeps its lock."""
        descriptor, self._lock = self._lock, None
        if descriptor is not None:
            os.close(descriptor)

    def _run(self) -> None:
        pause = WRITE_EVERY
        while not self._is_closed.wait(pause):
            start = time.monotonic()
            self._write()
            pause = max(WRITE_EVERY, 4 * (time.monotonic() - start))

    def _take_lock(self) -> None:
        if self._lock is not None:
            return
        path = f"{os.path.realpath(self._path)}.lock"  # one lock, by whatever link it is reached
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            lock_file(descriptor)
        except OSError as error:
            os.close(descriptor)
            if isinstance(error, BlockingIOError):
                raise BlockingIOError(error.errno, "in use by another program") from None
            raise
        self._lock = descriptor
        state.remove_leftovers(self._path)

    def _load(self) -> None:
        try:
            self._take_lock()
        except OSError as error:
            if error.errno not in CANNOT_WRITE:
                raise ValueError(f"{self._path}: {error.strerror}") from None
            self._fail(error)
        try:
            text = state.read_text(self._path)
        except FileNotFoundError:
            return
        except OSError as error:
            raise ValueError(f"{self._path}: {error.strerror}") from None
        if text == self._text:
            return
        try:
            state.load_state(self._path, text, self._served())
        except ValueError as error:
            advice = "rename the file to start without its values"
            raise ValueError(f"{error}; no value was loaded: {advice}") from None
        self._text = text

    def _write(self) -> None:
        """Write the file if a value has changed. Never raises an Exception."""
        try:
            units: dict[int | None, tuple[object, str]] = {}
            for unit, device in self._served().items():
                values = device, state.fingerprint(device)
                before, text = self._units.get(unit, (None, ""))
                units[unit] = values, text if values == before else state.unit_text(unit, device)
            if units == self._units and not self._is_failing:
                return
            self._units = units
            text = state.state_text(text for _, text in units.values())
            if text != self._text or self._is_failing:
                self._take_lock()
                state.replace_file(self._path, text)
                self._text = text
        except Exception as error:
            self._fail(error)
            return
        if self._is_failing:
            self._is_failing = False
            logger.warning("%s: values are kept again", self._path)

    def _fail(self, error: Exception) -> None:
        if not self._is_failing:
            self._is_failing = True
            reason = (error.strerror if isinstance(error, OSError) else None) or repr(error)
            text = "%s: %s; until it can be written, values are not kept"
            logger.warning(text, self._path, reason)

    def _served(self) -> dict[int | None, Device]:
        devices = self._devices()
        return {None: devices} if isinstance(devices, Device) else dict(devices.items())
