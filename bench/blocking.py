"""
Blocking reads of ten holding registers over loopback TCP, side by side.

Every client reads from the same server, libmodbus's own in C, in turns; printed
are the medians over the rounds, and the ratio to libmodbus's own client in C.
"""

from __future__ import annotations

import argparse
import random
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from pymodbus.client import ModbusTcpClient

from libmodbus_py import TcpContext

HERE = Path(__file__).parent


def build(source: str, folder: str) -> str:
    program = f"{folder}/{source}"
    subprocess.run(["gcc", "-O2", "-o", program, f"{HERE / source}.c", "-lmodbus"], check=True)
    return program


def rate(read: Callable[[], object], count: int) -> float:
    start = time.perf_counter()
    for _ in range(count):
        read()
    return count / (time.perf_counter() - start)


def through_context(port: int, count: int, native: bool | None) -> float:
    with TcpContext("127.0.0.1", port, native=native) as context:
        return rate(lambda: context.read_holding_registers(0, 10), count)


def through_pymodbus(port: int, count: int) -> float:
    with ModbusTcpClient("127.0.0.1", port=port) as client:
        return rate(lambda: client.read_holding_registers(0, count=10), count)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20_000, help="requests a round (20000)")
    parser.add_argument("--rounds", type=int, default=10, help="rounds (10)")
    options = parser.parse_args()
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        client = build("client", folder)
        server = stack.enter_context(
            subprocess.Popen([build("server", folder)], stdout=subprocess.PIPE, text=True)
        )
        stack.callback(server.kill)
        assert server.stdout is not None
        port = int(server.stdout.readline())
        clients: dict[str, Callable[[], float]] = {
            "libmodbus, its own client in C": lambda: float(
                subprocess.check_output([client, str(port), str(options.count)])
            ),
            "TcpContext (default)": lambda: through_context(port, options.count, None),
            "TcpContext (native=True)": lambda: through_context(port, options.count, True),
            "TcpContext (native=False)": lambda: through_context(port, options.count, False),
            "pymodbus": lambda: through_pymodbus(port, options.count // 4),
        }
        report(run(clients, options.rounds))


def run(clients: dict[str, Callable[[], float]], rounds: int) -> dict[str, list[float]]:
    rates: dict[str, list[float]] = {name: [] for name in clients}
    for number in range(rounds):
        if sys.stderr.isatty():
            print(f"\rround {number + 1} of {rounds}", end="", file=sys.stderr, flush=True)
        # Who comes before whom makes a difference: another order in each round, the
        # same in each run.
        turns = list(clients.items())
        random.Random(number).shuffle(turns)
        for name, measure in turns:
            rates[name].append(measure())
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr)
    return rates


def report(rates: dict[str, list[float]]) -> None:
    base, *_ = (statistics.median(values) for values in rates.values())
    print(f"{'read_holding_registers(0, 10), loopback':<42}{'per second':>12}{'ratio':>8}")
    for name, values in rates.items():
        median = statistics.median(values)
        print(f"{name:<42}{median:>12,.0f}{median / base:>8.2f}")


if __name__ == "__main__":
    main()
