"""
The file in which a server keeps the values of its devices, so that they survive a restart.

A second file, with the ending ".lock", is locked, so that no other program uses it. `tell` is
called in any thread with a line when writing first fails, and when it succeeds again. A ValueError
says why the file cannot be used; no value is taken from it then.
"""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable, Mapping

from ...device.device import Device
from ...device.state import (
    fingerprint,
    load_state,
    read_text,
    remove_leftovers,
    replace_file,
    state_text,
)
from ...ports.port import abandoned_in_children
from ...system import lock_file

__all__ = ["ValuesFile"]

# Seconds between two times of writing.
WRITE_EVERY = 1.0

# Errors after which the devices are served all the same, and their values are not kept.
CANNOT_WRITE = (errno.EACCES, errno.EPERM, errno.EROFS, errno.ENOSPC, errno.EDQUOT)

Devices = Device | Mapping[int, Device]


class ValuesFile:
    """Keeps the values of devices in a file, replaced at most once a second and at the end."""

    def __init__(
        self, path: str, devices: Callable[[], Devices], *, tell: Callable[[str], object]
    ) -> None:
        self._path = path
        self._devices = devices
        self._tell = tell
        self._lock: int | None = None
        self._owner = os.getpid()
        self._is_failing = False
        self._is_closed = threading.Event()
        self._seen: object = None
        self._text = ""
        self._thread = threading.Thread(target=self._run, name="values file", daemon=True)
        try:
            self._load()
        except BaseException:
            self.abandon()
            raise
        abandoned_in_children(self)

    def start(self) -> None:
        """Write the file, and begin to keep it up to date."""
        self._write()
        self._thread.start()

    def close(self) -> None:
        """Write the file for the last time, and let others use it. Any number of times."""
        if self._owner != os.getpid() or self._is_closed.is_set():
            return
        self._is_closed.set()
        if self._thread.ident is not None:
            self._thread.join()
        self._write()
        self.abandon()

    def abandon(self) -> None:
        """Close the lock without saving; in a forked child, the parent keeps its lock."""
        descriptor, self._lock = self._lock, None
        if descriptor is not None:
            os.close(descriptor)

    def _run(self) -> None:
        while not self._is_closed.wait(WRITE_EVERY):
            self._write()

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
        remove_leftovers(self._path)

    def _load(self) -> None:
        try:
            self._take_lock()
        except OSError as error:
            if error.errno not in CANNOT_WRITE:
                raise ValueError(f"{self._path}: {error.strerror}") from None
            self._fail(error)
        try:
            text = read_text(self._path)
        except FileNotFoundError:
            return
        except OSError as error:
            raise ValueError(f"{self._path}: {error.strerror}") from None
        try:
            load_state(self._path, text, self._units())
        except ValueError as error:
            advice = "rename the file to start without its values"
            raise ValueError(f"{error}; no value was loaded: {advice}") from None
        self._text = text

    def _write(self) -> None:
        """Write the file if a value has changed. Never raises an Exception."""
        try:
            devices = self._units()
            seen = [(unit, id(each), fingerprint(each)) for unit, each in devices.items()]
            if seen == self._seen and not self._is_failing:
                return
            text = state_text(devices)
            if text != self._text or self._is_failing:
                self._take_lock()
                replace_file(self._path, text)
                self._text = text
            self._seen = seen
        except Exception as error:
            self._fail(error)
            return
        if self._is_failing:
            self._is_failing = False
            self._tell(f"{self._path}: values are kept again")

    def _fail(self, error: Exception) -> None:
        if not self._is_failing:
            self._is_failing = True
            reason = (error.strerror if isinstance(error, OSError) else None) or repr(error)
            self._tell(f"{self._path}: {reason}; until it can be written, values are not kept")

    def _units(self) -> dict[int | None, Device]:
        devices = self._devices()
        return {None: devices} if isinstance(devices, Device) else dict(devices.items())
