"""
A fleet with a journal that is killed: python -m fuzz.journal_trial [KILLS] [DEVICES]

A poll of the command line with DEVICES, 20 unless told otherwise, writes to a file and to a
mosquitto. It is killed (kill -9) KILLS times, 10 unless told otherwise, at random moments, and so
is the mosquitto. At the end the readings of the journal are compared with what has arrived.

Prints a table; exits with 1 if a reading of the journal has not arrived, or if more than one batch
was repeated for a kill.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import random
import signal
import socket
import sqlite3
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from pathlib import Path

from fuzz.command import numbers
from libmodbus_py import Device, Mapping, Server
from libmodbus_py.services.fleet.outputs.writer import MOST_OF_JOURNAL

POINTS = 10

LONGEST = 60.0

SUBSCRIBER = "journal-trial"


class KilledPolls:
    """
    A poll that writes to a file, and to a broker if there is one, and is killed.

    Args:
        folder: for its files.
        urls: of its devices.
        broker: the port of a mosquitto; 0 for none.
        interval: of the polls of a device, in seconds.
    """

    def __init__(
        self, folder: Path, urls: list[str], broker: int = 0, interval: float = 0.2
    ) -> None:
        self._folder = folder
        self.file: Path = folder / "readings.jsonl"
        self.journal: Path = folder / "fleet.db"
        points = "".join(
            f"[[device.point]]\nname = 'p{at}'\ntable = 'holding_registers'\naddress = {at}\n"
            for at in range(POINTS)
        )
        devices = "".join(
            f"[[device]]\nname = 'd{at}'\nurl = '{url}'\ninterval = {interval}\n{points}"
            for at, url in enumerate(urls)
        )
        mqtt = f"[output.mqtt]\nurl = 'mqtt://127.0.0.1:{broker}'\nqos = 1\n" if broker else ""
        (folder / "fleet.toml").write_text(
            f"journal = 'fleet.db'\n{devices}[output.json]\npath = 'readings.jsonl'\n{mqtt}"
        )

    @contextlib.contextmanager
    def running(self) -> Iterator[subprocess.Popen[bytes]]:
        """Run the command poll, and kill it."""
        program = [sys.executable, "-m", "libmodbus_py", "poll", str(self._folder / "fleet.toml")]
        errors = (self._folder / "errors").open("ab")
        with errors, subprocess.Popen(program, stderr=errors) as process:
            try:
                yield process
            finally:
                process.kill()

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self.file.stat().st_size if self.file.exists() else 0

    def in_file(self) -> list[int]:
        """Return the ids in the file; a line that a kill has cut is left out."""
        found: list[int] = []
        for line in self.file.read_bytes().splitlines():
            with contextlib.suppress(ValueError):
                found.append(json.loads(line)["id"])
        return found

    def places(self) -> dict[str, int]:
        """Return the last id that each output has confirmed."""
        with contextlib.closing(sqlite3.connect(self.journal)) as database:
            return dict(database.execute("SELECT * FROM place"))

    def in_journal(self) -> list[int]:
        """Return the ids in the journal."""
        with contextlib.closing(sqlite3.connect(self.journal)) as database:
            return [number for (number,) in database.execute("SELECT id FROM reading ORDER BY id")]

    def errors(self) -> str:
        """Return what the polls have printed."""
        return (self._folder / "errors").read_text()


class Found:
    """
    The readings that have arrived somewhere, compared with those of the journal.

    Attributes:
        lost: readings of the journal up to the confirmed one that have not arrived.
        repeated: readings that arrived again.
        ahead: readings that arrived, and were never in the journal.
    """

    def __init__(self, journal: list[int], confirmed: int, arrived: list[int]) -> None:
        counts = Counter(arrived)
        self.lost: int = len({reading for reading in journal if reading <= confirmed} - {*counts})
        self.repeated: int = sum(counts.values()) - len(counts)
        self.ahead: int = len({*counts} - {*journal})


async def until(is_so: Callable[[], bool]) -> None:
    """Wait for it."""
    async with asyncio.timeout(LONGEST):
        while not is_so():
            await asyncio.sleep(0.005)


@contextlib.asynccontextmanager
async def devices(count: int) -> AsyncIterator[list[str]]:
    """Serve devices whose values move."""
    mapping = Mapping(holding_registers=POINTS)

    async def move() -> None:
        at = 0
        while True:
            at = (at + 1) % 60000
            mapping.holding_registers[:] = range(at, at + POINTS)
            await asyncio.sleep(0.01)

    places = ["tcp://127.0.0.1:0"] * count
    async with Server({1: Device(mapping)}).serving(*places) as running:
        moving = asyncio.create_task(move())
        try:
            yield list(running.urls)
        finally:
            moving.cancel()


class Broker:
    """A mosquitto that keeps the messages for its subscriber."""

    def __init__(self, folder: Path) -> None:
        with socket.create_server(("127.0.0.1", 0)) as taken:
            self.port: int = taken.getsockname()[1]
        self._file = folder / "mosquitto.conf"
        self._file.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous true\nuser root\n"
            f"max_queued_messages 0\n"
        )
        self.start()

    def start(self) -> None:
        program = ["mosquitto", "-c", str(self._file)]
        self.process: subprocess.Popen[bytes] = subprocess.Popen(
            program, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()


class Subscriber:
    """
    Receives the readings of a broker, also of one that comes back.

    Attributes:
        ids: of all readings.
    """

    def __init__(self, port: int) -> None:
        self.ids: list[int] = []
        self.is_there: bool = False
        self._port = port

    async def run(self) -> None:
        import aiomqtt

        while True:
            try:
                async with aiomqtt.Client("127.0.0.1", self._port) as client:
                    await client.subscribe("modbus/+/+", 1)
                    self.is_there = True
                    async for message in client.messages:
                        if not message.retain:
                            assert isinstance(message.payload, bytes)
                            self.ids.append(json.loads(message.payload)["id"])
            except aiomqtt.MqttError:
                self.is_there = False
                await asyncio.sleep(0.02)


async def trial(folder: Path, kills: int, count: int) -> bool:
    broker = Broker(folder)
    subscriber = Subscriber(broker.port)
    listening = asyncio.create_task(subscriber.run())
    await until(lambda: subscriber.is_there)
    try:
        async with devices(count) as urls:
            polls = KilledPolls(folder, urls, broker.port)
            for _ in range(kills):
                with polls.running():
                    size = polls.size
                    await until(lambda size=size: polls.size > size)  # type: ignore[misc]
                    await asyncio.sleep(random.uniform(0.0, 2.0))
            last = polls.in_journal()[-1]
            with polls.running() as process:  # what waited is sent
                await until(lambda: min(polls.places().values()) >= last)
                process.send_signal(signal.SIGTERM)
                await asyncio.to_thread(process.wait)
    finally:
        listening.cancel()
        await asyncio.wait([listening])
        broker.kill()
    journal = polls.in_journal()
    print(f"{len(journal)} readings in the journal after {kills} kills")
    is_good = True
    print(f"{'':8} {'arrived':>9} {'lost':>6} {'repeated':>9} {'ahead of the journal':>21}")
    for name, ids in (("json", polls.in_file()), ("mqtt", subscriber.ids)):
        [confirmed] = [at for output, at in polls.places().items() if output.startswith(name)]
        found = Found(journal, confirmed, ids)
        print(f"{name:8} {len(ids):9} {found.lost:6} {found.repeated:9} {found.ahead:21}")
        is_good = is_good and not found.lost and found.repeated <= kills * MOST_OF_JOURNAL
    print(polls.errors(), end="", file=sys.stderr)
    return is_good


def main() -> None:
    kills, count = numbers(__doc__, KILLS=10, DEVICES=20)
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        is_good = asyncio.run(trial(Path(folder), kills, count))
    print(f"{time.monotonic() - started:.0f} s")
    sys.exit(0 if is_good else 1)


if __name__ == "__main__":
    main()
