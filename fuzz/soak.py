"""
Everything at once, for long: python -m fuzz.soak [SECONDS] [SEED]

A server in a process of its own, on TCP, RTU and ASCII. For SECONDS, 60 unless told
otherwise, transactions go over serial lines on which things go wrong, hostile clients attack
over TCP, and an innocent one reads beside them. The server's descriptors, threads and memory
are watched. Prints counts; exits with 1 on a wrong value, a loss that was not
reported, a failure of the innocent client, or growth.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from fuzz.bad_line import UNITS, BadLine
from fuzz.command import numbers, progress
from fuzz.hostile import Hostile, Innocent
from fuzz.serial_faults import BAUDRATE, LINES, client
from fuzz.transactions import Lateness, Tally, Transactions, known_device, seconds_left
from libmodbus_py import Client, Server

TIMEOUT = 0.25  # the server has the hostile clients to deal with, too

HOSTILES = 2

# The memory that an allocator may keep after a flood.
KEPT_KILOBYTES = 16_384

# One unit for each line, so that no client sees values of another one.
UNIT = dict(zip(LINES, UNITS, strict=True))


class Size(NamedTuple):
    """Of a process."""

    descriptors: int
    threads: int
    kilobytes: int

    @classmethod
    def of(cls, process: int) -> Size:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
        status = dict(line.split(":", 1) for line in lines)
        descriptors = list(Path(f"/proc/{process}/fd").iterdir())
        return cls(len(descriptors), int(status["Threads"]), int(status["VmRSS"].split()[0]))

    def has_grown_from(self, before: Size) -> bool:
        return (
            self.descriptors > before.descriptors
            or self.threads > before.threads
            or self.kilobytes > before.kilobytes + KEPT_KILOBYTES
        )


def serve(urls: list[str]) -> None:
    """Be the server, until the input ends."""
    devices = {unit: known_device() for unit in UNITS}
    with Server(devices).background(*urls) as running:
        print(running.urls[0], flush=True)
        sys.stdin.read()


@contextlib.contextmanager
def served(lines: dict[str, BadLine]) -> Iterator[tuple[int, int]]:
    """Run the server; return its process and its port."""
    urls = ["tcp://127.0.0.1:0"]
    urls += [
        f"{LINES[name][0]}://{line.server}?baudrate={BAUDRATE}" for name, line in lines.items()
    ]
    command = [sys.executable, "-m", "fuzz.soak", "serve", *urls]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            yield process.pid, int(process.stdout.readline().rpartition(b":")[2])
        finally:
            process.stdin.close()
            process.wait(10)


def on_a_line(name: str, line: BadLine, port: int, seconds: float, seed: int) -> Tally:
    with (
        client(name, line.client, TIMEOUT, UNIT[name]) as context,
        Client(f"tcp://127.0.0.1:{port}", unit=UNIT[name], timeout=10) as clean,
        Lateness() as lateness,
    ):
        return Transactions(context, clean, line, lateness, seed).run(seconds_left(seconds))


def attack(port: int, seconds: float, seed: int) -> dict[str, int]:
    with Hostile(port, seed) as hostile:
        time.sleep(seconds)
    return {**hostile.by_kind, "bytes": hostile.sent}


def settled(process: int, before: Size) -> Size:
    """Wait until closed connections are counted as closed."""
    goes_on = seconds_left(5)
    while (size := Size.of(process)).has_grown_from(before) and goes_on():
        time.sleep(0.05)
    return size


def main() -> int:
    seconds, seed = numbers(__doc__, seconds=60, seed=1)
    with contextlib.ExitStack() as stack:
        # Before there are threads, which a fork does not bring along.
        processes = stack.enter_context(ProcessPoolExecutor(HOSTILES))
        warm = [processes.submit(time.sleep, 0.1) for _ in range(HOSTILES)]
        assert all(future.result() is None for future in warm)
        lines = {
            name: stack.enter_context(BadLine(framing, TIMEOUT, seed + number))
            for number, (name, (framing, _)) in enumerate(LINES.items())
        }
        process, port = stack.enter_context(served(lines))
        with Innocent(port, seed) as innocent:
            innocent.read()
        before = Size.of(process)

        threads = stack.enter_context(ThreadPoolExecutor(len(LINES)))
        transactions = {
            name: threads.submit(on_a_line, name, line, port, seconds, seed + number)
            for number, (name, line) in enumerate(lines.items())
        }
        attacks = [
            processes.submit(attack, port, seconds, seed + number) for number in range(HOSTILES)
        ]
        goes_on, largest = seconds_left(seconds), before
        with progress(f"soak of {seconds} s"), Innocent(port, seed) as innocent:
            while goes_on():
                innocent.read()
                largest = Size(*map(max, largest, Size.of(process)))
                time.sleep(0.005)
        tallies = {name: future.result() for name, future in transactions.items()}
        hostile = [future.result() for future in attacks]
        after = settled(process, before)

    for name, tally in tallies.items():
        print(name, tally, "", sep="\n")
    for kind in hostile[0]:
        print(f"{'hostile streams: ' + kind:42}{sum(row[kind] for row in hostile):>9}")
    print(f"{'right reads of the innocent client':42}{innocent.reads:>9}")
    print(f"{'its failures and wrong values':42}{len(innocent.findings):>9}")
    print(*innocent.findings[:20], sep="\n")
    for when, size in (("before", before), ("at most", largest), ("after", after)):
        print(f"server {when}: {size}")
    good = all(tally.is_good for tally in tallies.values())
    return 0 if good and not innocent.findings and not after.has_grown_from(before) else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve(sys.argv[2:])
    else:
        sys.exit(main())
