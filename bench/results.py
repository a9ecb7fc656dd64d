"""
The numbers of all rounds, and their medians.
"""

from __future__ import annotations

import random
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from statistics import median

from bench.cells import Cells, Key, Measured
from bench.children import Failed


@dataclass
class Results:
    """
    Attributes:
        measured: the rounds of each cell.
        failed: why a cell has fewer rounds than others, or none.
    """

    measured: dict[Key, list[Measured]] = field(default_factory=lambda: defaultdict(list))
    failed: dict[Key, str] = field(default_factory=dict)

    def keys(self, section: str) -> list[Key]:
        """Return the cells of a section in the order of its tables."""
        return [key for key in {**self.measured, **self.failed} if key.section == section]

    def note(self, key: Key) -> str:
        """Say why the cell has no number to compare with others; empty if it has one."""
        notes = [seconds.note for seconds in self.measured.get(key, []) if seconds.note]
        return self.failed.get(key) or (notes[0] if notes else "")

    def rate(self, key: Key) -> float | None:
        """Return the requests in a second, also of a cell with a note."""
        return self._median(key, lambda each: each.requests / each.seconds)

    def client_cost(self, key: Key) -> float | None:
        """Return the client's microseconds of processor time for a request."""
        return self._median(key, lambda each: each.client_cpu / max(1, each.requests) * 1e6)

    def server_cost(self, key: Key) -> float | None:
        """Return the server's microseconds of processor time for a request."""
        return self._median(key, lambda each: each.server_cpu / max(1, each.requests) * 1e6)

    def latency(self, key: Key) -> float | None:
        """Return the microseconds that 99 of 100 requests stay below."""
        return self._median(key, lambda each: each.p99)

    def _median(self, key: Key, value: Callable[[Measured], float | None]) -> float | None:
        values = [
            found for seconds in self.measured.get(key, []) if (found := value(seconds)) is not None
        ]
        return median(values) if values else None


def run_rounds(section: str, cells: Cells, rounds: int, seconds: float, results: Results) -> None:
    """Measure every cell once in each round; one that fails is left out from then on."""
    for key in cells:
        results.measured[key] = []  # the order of the tables
    for number in range(rounds):
        # Who comes before whom makes a difference: another order in each round, the
        # same in each run.
        turns = [(key, measure) for key, measure in cells.items() if key not in results.failed]
        random.Random(number).shuffle(turns)
        for key, measure in with_progress(turns, f"{section}, round {number + 1} of {rounds}"):
            try:
                results.measured[key].append(measure(seconds))
            except Failed as failure:
                results.failed[key] = str(failure)


def with_progress(
    turns: list[tuple[Key, Callable[[float], Measured]]], title: str
) -> Iterable[tuple[Key, Callable[[float], Measured]]]:
    """Show progress on a terminal; nothing elsewhere."""
    for number, turn in enumerate(turns, 1):
        if sys.stderr.isatty():
            print(f"\r\033[K{title}: {number} of {len(turns)}", end="", file=sys.stderr, flush=True)
        yield turn
    if sys.stderr.isatty():
        print("\r\033[K", end="", file=sys.stderr, flush=True)
