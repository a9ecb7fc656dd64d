"""
The clockwork of a device: what is read is computed in that moment, from the time since the start.

So a simulator that nobody asks does nothing.
"""

from __future__ import annotations

import random
import time
from bisect import bisect_right
from collections.abc import Callable, Iterable
from typing import Any

from ...device.mapping import Mapping
from ...protocol.errors import ServerDeviceFailure
from ...protocol.tables import TABLES
from .runs import Compute, Run, fitting

__all__ = ["Clockwork"]


class Clockwork:
    """
    Keeps the moving values of a mapping up to date: those that are looked at.

    Args:
        mapping: holds the values.
        runs: all values of it, which do not overlap.
        clock: gives seconds; the time of the call is the start.

    Attributes:
        seed: what random moves begin with that have no seed of their own.
    """

    def __init__(
        self, mapping: Mapping, runs: Iterable[Run], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._mapping = mapping
        self._clock = clock
        self._start = clock()
        self.seed: int = random.getrandbits(64)
        self._runs: dict[str, list[Run]] = {table: [] for table in TABLES}
        for run in sorted(runs, key=lambda run: run.first):
            self._runs[run.table].append(run)
        self._moving: dict[tuple[str, int], Compute] = {}

    def start(self, run: Run) -> None:
        """
        Let the values of a run move, if they have a behaviour.

        Raises:
            ValueError: the behaviour does not go with them.
        """
        if run.behaviour is not None:
            self._moving[run.table, run.first] = run.behaviour.begin(run, self)

    def go_on_from(self, before: Clockwork) -> None:
        """Move on as another one began."""
        self._start, self.seed = before._start, before.seed

    def find(self, table: str, address: int) -> Run | None:
        """Give the run that has an address."""
        runs = self._runs[table]
        at = bisect_right(runs, address, key=lambda run: run.first) - 1
        return runs[at] if at >= 0 and address < runs[at].stop else None

    def refresh(self, table: str, address: int, count: int) -> None:
        """
        Compute what is about to be read.

        Raises:
            ServerDeviceFailure: what is copied is no value of its type.
        """
        if not self._moving:
            return
        now = self._clock() - self._start
        stop = address + count
        runs = self._runs[table]
        at = max(bisect_right(runs, address, key=lambda run: run.first) - 1, 0)
        while at < len(runs) and runs[at].first < stop:
            run = runs[at]
            first = max(address - run.first, 0) // run.kind.registers
            last = (min(stop, run.stop) - run.first - 1) // run.kind.registers
            self._refresh(run, range(first, last + 1), now)
            at += 1

    def values(self, run: Run, indices: range, now: float) -> list[Any]:
        """Give some values, at a time since the start."""
        self._refresh(run, indices, now)
        width = run.kind.registers
        cells = list(map(int, self._table(run)[run.place(indices)]))
        if indices.step > 1:
            starts = range(0, len(cells), width * indices.step)
            cells = [cell for start in starts for cell in cells[start : start + width]]
        try:
            return run.kind.decode_many(cells)
        except ValueError as error:
            raise ServerDeviceFailure(str(error)) from None

    def _refresh(self, run: Run, indices: range, now: float) -> None:
        compute = self._moving.get((run.table, run.first))
        if compute is None:
            return
        values = [fitting(run.kind, value) for value in compute(indices, now)]
        if indices.step == 1:
            self._table(run)[run.place(indices)] = run.kind.encode_many(values)
        else:
            for index, value in zip(indices, values, strict=True):
                self._table(run)[run.place(range(index, index + 1))] = run.kind.encode(value)

    def _table(self, run: Run) -> Any:
        return getattr(self._mapping, run.table)
