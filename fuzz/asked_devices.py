"""
Devices that record who asks them, and workers that ask: what happens when workers die.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.ports.trace import TracedFrame

__all__ = ["Asked", "Workers", "asked_devices", "fleet_file", "until"]

UNITS = 10
"""Behind each connection."""

MAP = """
[[point]]
name = "level"
table = "holding_registers"
address = 0

[[point]]
name = "setpoint"
table = "holding_registers"
address = 1
minimum = 10
maximum = 30
"""


# Seconds. Whoever asks a device has asked it within them before: no interval here is as long.
RETURN = 5.0


class Asked:
    """
    Who asked when. A worker has one connection to a place, and another one when it gets that place
    again. So who asks a device, and had asked it before somebody else just did, is one of two.

    Long ago means nothing: the system gives ports a second time.

    Attributes:
        polls: how often devices were asked.
        doubles: how often one of two asked.
        gap: the longest time, in seconds, in which a device was not asked, since `forget`.
    """

    def __init__(self) -> None:
        self.polls: int = 0
        self.doubles: int = 0
        self.gap: float = 0.0
        self._last: dict[tuple[str, int], tuple[float, str]] = {}
        # When those asked the last time whom others have followed.
        self._followed: dict[tuple[str, int], dict[str, float]] = {}

    def note(self, traced: TracedFrame) -> None:
        if traced.direction != "received":
            return
        now, device = time.monotonic(), (traced.endpoint, traced.unit or 0)
        asking = traced.peer or ""
        self.polls += 1
        before, peer = self._last.get(device, (now, asking))
        self.gap = max(self.gap, now - before)
        if asking != peer:
            followed = self._followed.setdefault(device, {})
            followed[peer] = before
            self.doubles += now - followed.pop(asking, -RETURN) < RETURN
        self._last[device] = now, asking

    @property
    def peers(self) -> dict[tuple[str, int], str]:
        """From where each device was asked the last time."""
        return {device: peer for device, (_, peer) in self._last.items()}

    def forget(self) -> None:
        self.gap = 0.0

    def since(self, at: float) -> int:
        """How many devices were asked since."""
        return sum(last >= at for last, _ in [*self._last.values()])

    def places_since(self, at: float) -> int:
        """How many places were asked for any of their units since."""
        return len({place for (place, _), (last, _) in self._last.items() if last >= at})

    @property
    def latest(self) -> float:
        """When any device was asked the last time."""
        return max(last for last, _ in self._last.values())

    @property
    def silence(self) -> float:
        """How long it is that the device was asked that waits longest."""
        return time.monotonic() - min(last for last, _ in self._last.values())


@contextlib.contextmanager
def asked_devices(connections: int) -> Iterator[tuple[list[str], Asked]]:
    """Serve ten units on each of so many ports; return the URLs, and the record of requests."""
    asked = Asked()
    devices = {unit: Device(Mapping(holding_registers=10)) for unit in range(1, UNITS + 1)}
    server = Server(devices, trace=asked.note)
    with server.background(*["tcp://127.0.0.1:0"] * connections) as running:
        yield running.urls, asked


def fleet_file(
    directory: Path, urls: list[str], *, interval: float, engine: str, zone: str = ""
) -> Path:
    """Write a fleet file; return its path."""
    (directory / "map.toml").write_text(MAP)
    lines = ["name,url,unit,map,interval,timeout,zone"]
    lines += [
        f"d{at}-{unit},{url},{unit},map.toml,{interval},0.2,{zone}"
        for at, url in enumerate(urls)
        for unit in range(1, UNITS + 1)
    ]
    (directory / "devices.csv").write_text("\n".join(lines) + "\n")
    path = directory / "fleet.toml"
    path.write_text(f'devices = "devices.csv"\n\n[engine]\n{engine}\n')
    return path


class Workers:
    """
    Processes of the real command line.

    Args:
        file: a fleet file.
        directory: for what they say.
    """

    def __init__(self, file: Path, directory: Path) -> None:
        self._file = file
        self._directory = directory
        self.running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, *_: object) -> None:
        for name in list(self.running):
            self.kill(name)

    def start(self, name: str, engine: str, *options: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "libmodbus_py", "poll", str(self._file)]
        command += ["--engine", engine, "--worker", name, *options]
        with open(self._directory / f"{name}.log", "ab") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, "PYTHONUNBUFFERED": "1"},
            )
        self.running[name] = process
        return process

    def signal(self, name: str, number: int) -> None:
        self.running[name].send_signal(number)

    def kill(self, name: str) -> None:
        process = self.running.pop(name)
        process.kill()
        process.wait()

    def ended(self, name: str, patience: float = 15) -> int:
        return self.running.pop(name).wait(patience)

    def said(self, name: str) -> str:
        return (self._directory / f"{name}.log").read_text()


def until(condition: Callable[[], bool], patience: float = 30) -> float:
    """Wait until a function returns True; return how long that took."""
    start = time.monotonic()
    while not condition():
        if time.monotonic() > start + patience:
            raise TimeoutError("it does not come true")
        time.sleep(0.01)
    return time.monotonic() - start
