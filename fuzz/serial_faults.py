"""
Faults on serial lines: python -m fuzz.serial_faults [TRANSACTIONS] [SEED]

Does as many transactions, 100000 unless told otherwise, spread over RTU and ASCII, each on four
lines at a time. Prints what happened; exits with
1 if a wrong value or an unreported loss got through, or a fault spoiled more
than one transaction after it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

from fuzz.bad_line import UNITS, BadLine, Framing
from fuzz.command import numbers, progress
from fuzz.transactions import Lateness, Tally, Transactions, known_device
from libmodbus_py import Client, Server

__all__ = ["BAUDRATE", "LINES", "client", "on_a_line"]

# The framing on each line.
LINES: dict[str, Framing] = {"RTU": "rtu", "ASCII": "ascii"}

BAUDRATE = 1_000_000  # a pty ignores the rate; the client waits for frames of this rate

AT_A_TIME = 4  # lines of each kind, a process each: a transaction waits most of its time

TIMEOUT = 0.1  # five times what the framer of RTU calls silence


def client(name: str, device: str, timeout: float, unit: int = UNITS[0]) -> Client:
    """Make the client of one of `LINES`."""
    return Client(f"{LINES[name]}://{device}?baudrate={BAUDRATE}", unit=unit, timeout=timeout)


def on_a_line(name: str, timeout: float, seed: int, goes_on: Callable[[], bool]) -> Tally:
    """Do transactions on one of `LINES`, with a server in this process."""
    framing = LINES[name]
    with (
        BadLine(framing, timeout, seed) as line,
        Server({UNITS[0]: known_device()}).background(
            "tcp://127.0.0.1:0", f"{framing}://{line.server}?baudrate={BAUDRATE}"
        ) as running,
        Client(running.urls[0], unit=UNITS[0]) as clean,
        client(name, line.client, timeout) as context,
        Lateness() as lateness,
    ):
        return Transactions(context, clean, line, lateness, seed).run(goes_on)


def _in_a_process(name: str, count: int, seed: int) -> Tally:
    left = iter(range(count))
    return on_a_line(name, TIMEOUT, seed, lambda: next(left, None) is not None)


def main() -> int:
    total, seed = numbers(__doc__, transactions=100_000, seed=1)
    lines = [name for name in LINES for _ in range(AT_A_TIME)]
    tallies = {name: Tally() for name in LINES}
    with ProcessPoolExecutor(len(lines)) as processes, progress(f"{total} transactions"):
        counts = [-(-total // len(lines))] * len(lines)
        seeds = range(seed, seed + len(lines))
        found = processes.map(_in_a_process, lines, counts, seeds)
        for name, tally in zip(lines, found, strict=True):
            tallies[name] += tally
    for name, tally in tallies.items():
        print(f"{name}, from seed {seed + lines.index(name)}", tally, "", sep="\n")
    return 0 if all(tally.is_good for tally in tallies.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
