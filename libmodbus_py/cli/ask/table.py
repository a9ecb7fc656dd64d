"""
A table on a terminal, drawn again in place.
"""

from __future__ import annotations

import sys
import time
from collections import deque
from collections.abc import Sequence

from ...protocol.plain import clock_text
from ..redrawn import Redrawn
from .formatters import FormattedValue, ReadResult, aligned

__all__ = ["TerminalTable"]

CHANGED = "*"

SPARKS = "▁▂▃▄▅▆▇█"

MOST_SPARKS = 24
"""Values that a line of sparks shows, at most."""


class TerminalTable:
    """
    Draws a title, a line for each value with a mark after a change, and failures.

    Behind a number that has changed are the lowest and the highest one so far, and a bar for each
    of the last ones. The table fits the current size of the terminal.

    Args:
        title: the device, units and interval.
        units: those that are polled, one after the other.
    """

    def __init__(self, title: str, units: Sequence[int]) -> None:
        self._title = title
        self._groups = {unit: _Group() for unit in units}
        self._polls = self._failed = 0
        self._last_failure = ""
        self._redrawn = Redrawn(sys.stdout)

    def print(self, unit: int, results: Sequence[ReadResult]) -> None:
        self._count(unit, any(each.failure for each in results))
        self._groups[unit].take(results)
        self._draw()

    def fail(self, unit: int, reason: str) -> None:
        self._count(unit, True)
        self._groups[unit].lines = [(reason, False)]
        self._draw()

    def _count(self, unit: int, has_failed: bool) -> None:
        self._polls += unit == next(iter(self._groups))
        if has_failed:
            self._failed += 1
            self._last_failure = _clock()

    def _draw(self) -> None:
        failed = f", {self._failed} failed, last at {self._last_failure}" if self._failed else ""
        title = f"{_clock()}  {self._title}, {self._polls} polls{failed}"
        self._redrawn.draw([(title, False), *self._lines()])

    def _lines(self) -> Sequence[tuple[str, bool]]:
        if len(self._groups) == 1:
            (group,) = self._groups.values()
            return group.lines
        found: list[tuple[str, bool]] = []
        for unit, group in self._groups.items():
            found += [(f"unit {unit}", False), *group.lines]
        return found


class _Group:
    """
    The lines of one unit.

    Attributes:
        lines: each with True if its value has just changed.
    """

    def __init__(self) -> None:
        self.lines: list[tuple[str, bool]] = []
        self._before: list[str] = []
        self._histories: list[_History] = []

    def take(self, results: Sequence[ReadResult]) -> None:
        rows = [row for each in results for row in each.rows]
        lines = aligned([(each.formatter, each.rows) for each in results])
        changed = self._changed([row.text for row in rows])
        if len(self._histories) != len(rows):
            self._histories = [_History() for _ in rows]
        for history, row in zip(self._histories, rows, strict=True):
            history.take(row)
        tails = [str(history) for history in self._histories]
        width = max((len(line) for line, tail in zip(lines, tails, strict=True) if tail), default=0)
        self.lines = [
            (f"{CHANGED if at in changed else ' '} {line:<{width}}  {tail}".rstrip(), at in changed)
            for at, (line, tail) in enumerate(zip(lines, tails, strict=True))
        ]
        self.lines += [(each.failure, False) for each in results if each.failure]

    def _changed(self, texts: list[str]) -> set[int]:
        """Return the lines with a new value; none if the number of lines changed."""
        before, self._before = self._before, texts
        if len(before) != len(texts):
            return set()
        return {at for at, (text, old) in enumerate(zip(texts, before, strict=True)) if text != old}


class _History:
    """The lowest, the highest and the last numbers of a value; ``str`` shows them."""

    def __init__(self) -> None:
        self._last: deque[float] = deque(maxlen=MOST_SPARKS)
        self._lowest: tuple[float, str] | None = None
        self._highest: tuple[float, str] | None = None

    def take(self, row: FormattedValue) -> None:
        try:
            number = float(row.plain)
        except ValueError:  # text, or no value
            return
        if number - number != 0:  # nan and the infinities
            return
        self._last.append(number)
        told = (number, row.text)
        if self._lowest is None or number < self._lowest[0]:
            self._lowest = told
        if self._highest is None or number > self._highest[0]:
            self._highest = told

    def __str__(self) -> str:
        if self._lowest is None or self._highest is None or self._lowest == self._highest:
            return ""
        (low, least), (high, most) = self._lowest, self._highest
        steps = [int((each - low) / (high - low) * (len(SPARKS) - 1)) for each in self._last]
        bars = "".join(SPARKS[step] for step in steps) if _has_sparks() else ""
        return f"{least}..{most}  {bars}".rstrip()


def _has_sparks() -> bool:
    try:
        SPARKS.encode(sys.stdout.encoding or "ascii")
    except (LookupError, UnicodeError):
        return False
    return True


def _clock() -> str:
    return clock_text(time.time())
