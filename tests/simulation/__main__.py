"""
Run the simulated world: ``python -m tests.simulation SECONDS [--seed N]``, or ``--broken``.

Runs the recorded seeds first, then fresh ones for so many seconds. A run that fails is made as
short as it can be, and what was said in it is printed; then the program exits with 1.
"""

import argparse
import logging
import math
import os
import sys
import time
from collections import Counter
from dataclasses import replace
from itertools import count

from .broken import BREAKS, Break
from .events import START
from .runs import Failure, options_of, run_or_failure, seed_options, shortest_options
from .scenarios import SCENARIOS
from .world import Options, World

# How much of an exchange is printed.
LINES = 40

# Seconds of processor time in which a rule that was taken out must be found.
PATIENCE = 10.0


class Tally:
    """What all runs came to."""

    def __init__(self) -> None:
        self.runs = 0
        self.seconds = 0.0
        self.calls = 0
        self.scenarios: Counter[str] = Counter()

    def add(self, options: Options, world: World) -> None:
        self.runs += 1
        self.seconds += world.events.now - START
        self.calls += world.checker.answered + world.checker.failed
        self.scenarios[options.scenario] += 1

    def __str__(self) -> str:
        return f"{self.runs} runs, {self.seconds / 3600:.2f} simulated hours, {self.calls} calls"


def main() -> int:
    parser = argparse.ArgumentParser(prog="./run simulate", description=__doc__)
    parser.add_argument("seconds", nargs="?", type=float, default=30.0, help="of fresh seeds")
    parser.add_argument("--seed", type=int, help="of the first fresh run; random otherwise")
    parser.add_argument("--scenario", choices=list(SCENARIOS), help="play this one only")
    parser.add_argument("--hours", type=float, help="of a whole plant in place of fresh seeds")
    parser.add_argument(
        "--broken", action="store_true", help="take out one rule at a time; each must be found"
    )
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    if options.broken:
        return _find_all()
    first = options.seed if options.seed is not None else int.from_bytes(os.urandom(4), "big")
    tally = Tally()
    if options.hours:
        runs = [_hour(first + number) for number in range(max(1, round(options.hours)))]
        failure = _try_all(runs, tally)
    else:
        failure = None if options.seed is not None else _try_all(seed_options(), tally)
        failure = failure or _try_fresh(first, options.seconds, options.scenario, tally)
    print(f"{tally}; first fresh seed {first}")
    if failure is None:
        return 0
    _print_failure(shortest_options(failure))
    return 1


def _hour(seed: int) -> Options:
    return Options(seed, "plant", seconds=3600.0, clients=4, units=20, pause=10.0)


def _try_all(runs: list[Options], tally: Tally) -> Failure | None:
    for options in runs:
        outcome = run_or_failure(options)
        if isinstance(outcome, Failure):
            return outcome
        tally.add(options, outcome)
    return None


def _try_fresh(first: int, seconds: float, scenario: str | None, tally: Tally) -> Failure | None:
    until = time.monotonic() + seconds
    for seed in count(first):
        if time.monotonic() >= until:
            return None
        options = options_of(seed)
        options = replace(options, scenario=scenario) if scenario else options
        failure = _try_all([options], tally)
        if failure is not None:
            return failure
    return None


def _print_failure(failure: Failure) -> None:
    print(f"\nseed {failure.options.seed}\n{failure.error}\n{failure.options}\n")
    for line in list(failure.exchange.raw())[-LINES:]:
        print(line)


def _find_all() -> int:
    """Break one rule after the other; each must be found in time."""
    missed = 0
    print("| rule taken out | found after | seed | by the rule |\n|---|--:|--:|---|")
    for break_ in BREAKS:
        start = time.process_time()
        failure = find(break_, seconds=PATIENCE)
        took = time.process_time() - start
        if failure is None:
            missed += 1
            print(f"| {break_.rule} | not within {PATIENCE:g} s | | |", flush=True)
        else:
            print(
                f"| {break_.rule} | {took:.2f} s | {failure.options.seed} | {failure.rule} |",
                flush=True,
            )
    return int(missed > 0)


def find(broken: Break, *, seconds: float = math.inf, seeds: int | None = None) -> Failure | None:
    """Break a rule, and play seeds until one shows it."""
    until = time.process_time() + seconds
    for seed in count() if seeds is None else range(seeds):
        if time.process_time() >= until:
            return None
        options = broken.options(options_of(seed))
        with broken.broken():
            outcome = run_or_failure(options)
        if isinstance(outcome, Failure):
            return outcome
    return None


if __name__ == "__main__":
    sys.exit(main())
