"""
What happened in a fleet, counted.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass, field

from .buffer import Buffer

__all__ = ["LATENESS_BOUNDS", "FleetStatistics", "OutputStatistics"]

LATENESS_BOUNDS: tuple[float, ...] = (*(0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0),)
"""Polls are counted by how many seconds they were late at most; the last count is of the rest."""


@dataclass(slots=True)
class OutputStatistics:
    """
    What became of the readings for one output.

    Attributes:
        buffer: where they wait.
        written: that it took.
        failures: how often it could not take any.
        trouble: why it takes none now; empty if it does.
    """

    buffer: Buffer = field(repr=False)
    written: int = 0
    failures: int = 0
    trouble: str = ""

    @property
    def dropped(self) -> int:
        """Those that it did not take, for too many waited."""
        return self.buffer.dropped

    @property
    def waiting(self) -> int:
        """Those that wait now."""
        return len(self.buffer)


@dataclass(slots=True, weakref_slot=True)
class FleetStatistics:
    """
    What happened in a fleet since it was made.

    Attributes:
        devices: that there are now.
        up: those of them that answered the last time.
        down: those that did not.
        polls: that are over, whatever came of them.
        failures: those that got no answer.
        refusals: those in which the device refused something, or answered what is no value.
        skipped: those whose time passed while the one before was still on its way.
        held: those that might not be sent (`may_ask`).
        readings: that were told.
        commands: that were carried out.
        refused_commands: that were not.
        lateness: how many polls began up to the first of `LATENESS_BOUNDS` seconds after
            their time, longer and up to the second, and so on.
        late_seconds: what all of them were late together.
        outputs: by name.
        worst: the longest that a poll was late since `take_worst` was called.
    """

    devices: int = 0
    up: int = 0
    down: int = 0
    polls: int = 0
    failures: int = 0
    refusals: int = 0
    skipped: int = 0
    held: int = 0
    readings: int = 0
    commands: int = 0
    refused_commands: int = 0
    lateness: list[int] = field(
        default_factory=lambda: [0] * (len(LATENESS_BOUNDS) + 1), repr=False
    )
    late_seconds: float = field(default=0.0, repr=False)
    outputs: dict[str, OutputStatistics] = field(default_factory=dict, repr=False)
    worst: float = field(default=0.0, repr=False)

    def note_start(self, late: float) -> None:
        """Count how late a poll began."""
        self.lateness[bisect_left(LATENESS_BOUNDS, late)] += 1
        self.late_seconds += late
        if late > self.worst:
            self.worst = late

    def take_worst(self) -> float:
        """Give the worst lateness since this was asked last."""
        worst, self.worst = self.worst, 0.0
        return worst

    def within(self, seconds: float) -> float:
        """Give the share of polls that were no later, 0..1; a bound of `LATENESS_BOUNDS`."""
        total = sum(self.lateness)
        return sum(self.lateness[: bisect_left(LATENESS_BOUNDS, seconds) + 1]) / (total or 1)
