"""
A line of pseudo-terminals where everybody hears everybody, as on two wires.
"""

from __future__ import annotations

import os
import select
import threading
from typing import Self

from libmodbus_py.tools.testing.wires import open_line, read_what_is_there, write_all

__all__ = ["SharedLine"]


class SharedLine:
    """
    Ports on one line: what is written to one comes out of all others.

    Args:
        names: of the ports, such as "client".

    Attributes:
        paths: of the ports, by name.
    """

    def __init__(self, *names: str) -> None:
        self.paths: dict[str, str] = {}
        self._masters: dict[str, int] = {}
        self._slaves: dict[str, int] = {}
        for name in names:
            self._plug(name)
        self._sleep, self._wake = os.pipe()
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._carry, name="bus", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        os.write(self._wake, b"x")
        self._thread.join()
        ends = (*self._masters.values(), *self._slaves.values(), self._wake, self._sleep)
        for descriptor in ends:
            os.close(descriptor)

    def unplug(self, name: str) -> None:
        """Take a port away, as pulling an adapter does."""
        with self._lock:
            os.close(self._masters.pop(name))
            os.close(self._slaves.pop(name))

    def plug(self, name: str, link: str) -> None:
        """Bring it back behind a symbolic link."""
        with self._lock:
            self._plug(name)
        os.unlink(link)
        os.symlink(self.paths[name], link)

    def say(self, data: bytes) -> None:
        """Put bytes on the line that all ports hear."""
        with self._lock:
            for master in self._masters.values():
                write_all(master, data)

    def _plug(self, name: str) -> None:
        self._masters[name], self._slaves[name], self.paths[name] = open_line()

    def _carry(self) -> None:
        while True:
            with self._lock:
                masters = list(self._masters.values())
            ready, _, _ = select.select([*masters, self._sleep], [], [], 0.05)
            if self._sleep in ready:
                return
            with self._lock:
                for master in self._masters.values():
                    if master in ready:
                        data = read_what_is_there(master)
                        for other in self._masters.values():
                            if other != master:
                                write_all(other, data)
