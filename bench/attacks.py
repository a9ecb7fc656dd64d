"""
A server under attack: ./run python -m bench.attacks [SECONDS]

What an innocent client sees before, and meanwhile.

The attacks are those of tests/support/attacks.py. Attackers and the innocent stand for other
machines: the server has a processor to itself (if there are two), the attackers run at the
lowest priority, and the innocent before all others (if root measures). Nobody else should
use this machine meanwhile.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from bench.attackers import AttackerProcess, Innocent, Polled
from tests.support.attacks import (
    ATTACKS,
    Attack,
    ServerProcess,
    churn,
    descriptor_limit,
    pipeline,
)

TARGET = 20
"""How many times as long as undisturbed the worst answer may take."""

PROCESSORS = os.sched_getaffinity(0)

CYCLES = 100_000
REQUESTS = 10_000_000

HEADER = f"""\
{"":30} {"requests":>8} {"lost":>5}   {"undisturbed, ms":^22}   {"under attack, ms":^22}
{"":30} {"":8} {"":5}   {"median":>6} {"p99":>7} {"worst":>7}   \
{"median":>6} {"p99":>7} {"worst":>7}   {"worst":>6}"""


def main() -> None:
    options = parse()
    if options.long:
        wear(churn, CYCLES, "connections, one after the other")
        wear(pipeline, REQUESTS, "requests, a hundred at a time")
        return
    attacks = [attack for attack in ATTACKS if attack.name in (options.only or [attack.name])]
    print(HEADER, flush=True)
    with descriptor_limit():
        for attack in attacks:
            print(row(attack.name, *measure(attack, options.seconds)), flush=True)


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="bench.attacks", description=__doc__)
    parser.add_argument("seconds", type=float, nargs="?", default=5.0, help="of each phase (5)")
    names = [attack.name for attack in ATTACKS]
    parser.add_argument(
        "--only", action="append", choices=names, metavar="ATTACK", help="may be repeated"
    )
    parser.add_argument(
        "--long",
        action="store_true",
        help=f"no attacks, but {CYCLES} connections and {REQUESTS} requests: what do they leave?",
    )
    return parser.parse_args()


def wear(work: Callable[[int, int], None], count: int, what: str) -> None:
    """Print what the server's process uses before and after much honest work."""
    with ServerProcess() as server:
        work(server.port, count // 20)
        before = server.settled_descriptors(), server.threads(), server.resident()
        start = time.monotonic()
        work(server.port, count)
        seconds = time.monotonic() - start
        after = server.settled_descriptors(), server.threads(), server.resident()
    print(f"{count} {what}: {seconds:.0f} s", flush=True)
    for name, was, became in zip(("descriptors", "threads", "bytes"), before, after, strict=True):
        print(f"    {name:12} {was:10} before {became:10} after", flush=True)


def measure(attack: Attack, seconds: float) -> tuple[Polled, Polled]:
    os.sched_setaffinity(0, PROCESSORS)
    with (
        tempfile.TemporaryDirectory() as directory,
        contextlib.nullcontext(attack.pki(Path(directory))) as pki,
        ServerProcess(pki=pki, attacked=attack.scheme) as server,
        Innocent(server.port, pki) as innocent,
        AttackerProcess(attack, server.attacked_port) as attackers,
    ):
        stand_for_others(server.pid, attackers.pid)
        innocent.poll(0.2)
        undisturbed = innocent.poll(seconds)
        attackers.begin()
        attacked = innocent.poll(seconds)
        attackers.end()
    return undisturbed, attacked


def stand_for_others(server: int, attackers: int) -> None:
    first, *rest = sorted(PROCESSORS)
    if rest:
        os.sched_setaffinity(server, {first})
        os.sched_setaffinity(attackers, rest)
        os.sched_setaffinity(0, rest)
    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(1))


def row(name: str, undisturbed: Polled, attacked: Polled) -> str:
    lost = undisturbed.lost + undisturbed.wrong + attacked.lost + attacked.wrong
    ratio = attacked.worst / undisturbed.worst
    met = "met" if ratio < TARGET and not lost else "not met"
    times = "   ".join(
        f"{polled.median * 1000:6.2f} {polled.p99 * 1000:7.2f} {polled.worst * 1000:7.2f}"
        for polled in (undisturbed, attacked)
    )
    return f"{name:30} {attacked.requests:8} {lost:5}   {times}   {ratio:5.1f}x {met}"


if __name__ == "__main__":
    main()
