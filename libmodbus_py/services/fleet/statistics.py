"""Counters of a fleet, of its outputs and of its journal."""

from __future__ import annotations

import time
from bisect import bisect_left
from dataclasses import dataclass, field

from .readings import Buffer

LATENESS_BOUNDS: tuple[float, ...] = (*(0.001, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 5.0),)
"""Upper bounds of the classes in which polls are counted by their lateness, in seconds."""

BEHIND_S = 10.0
"""Seconds that an output needs for more than one batch until it is behind: bursts are over then."""


@dataclass(slots=True)
class OutputStatistics:
    """
    Counters of one output.

    Attributes:
        buffer: the readings that wait for the output.
        written: readings written to the output.
        failures: failed attempts to open the output or to write to it.
        trouble: the error of the output now; empty if it works.
        trouble_since: when the output began to fail, in seconds since the epoch; 0 if it never did.
        no_backlog_at: when no more readings waited than one batch (time.monotonic).
    """

    buffer: Buffer = field(repr=False)
    written: int = 0
    failures: int = 0
    trouble: str = ""
    trouble_since: float = 0.0
    no_backlog_at: float = field(default_factory=time.monotonic, repr=False)

    def note_batch(self, count: int) -> None:
        """Note how many readings are written next."""
        if self.waiting <= count:
            self.no_backlog_at = time.monotonic()

    @property
    def is_failing(self) -> bool:
        """True while the output cannot be opened or written to."""
        return bool(self.trouble)

    @property
    def is_behind(self) -> bool:
        """True if more readings than one batch have waited for `BEHIND_S` seconds."""
        return self.waiting > 0 and time.monotonic() - self.no_backlog_at > BEHIND_S

    @property
    def dropped(self) -> int:
        """Readings dropped because too many waited, or because they could never be written."""
        return self.buffer.dropped

    @property
    def waiting(self) -> int:
        """Readings that wait for the output."""
        return len(self.buffer)


@dataclass(slots=True)
class JournalStatistics:
    """
    Counters of a journal.

    Attributes:
        bytes: the size of the journal on the disk.
        written: readings written to the journal.
        dropped: readings that the journal lacks, because the disk took none for too long.
        failures: failed attempts to write to the journal, or to read it.
        trouble: the error of the journal now; empty if it works.
    """

    bytes: int = 0
    written: int = 0
    dropped: int = 0
    failures: int = 0
    trouble: str = ""

    @property
    def is_failing(self) -> bool:
        """True while the journal cannot be written to or read."""
        return bool(self.trouble)


@dataclass(slots=True, weakref_slot=True)
class FleetStatistics:
    """
    Counters of a fleet since it was made.

    Attributes:
        devices: devices in the fleet now.
        up: devices that answered their last poll.
        down: devices that did not answer their last poll.
        polls: completed polls, failed ones included.
        failures: polls without an answer.
        refusals: polls in which a device refused a request or returned an invalid value.
        skipped: polls skipped because the previous poll of the device was still under way.
        vetoes: polls not sent because `may_ask` did not allow them.
        readings: readings passed to outputs.
        commands: writes carried out for outputs.
        refused_commands: writes refused or failed.
        lateness: number of polls by how late they began: up to the first of `LATENESS_BOUNDS`
            seconds, up to the second, and so on; the last number is of all others.
        late_seconds: the lateness of all polls together, in seconds.
        outputs: the counters of each output, by its name.
        journal: the counters of the journal; None without one.
        worst: the greatest lateness since `take_worst` was called, in seconds.
    """

    devices: int = 0
    up: int = 0
    down: int = 0
    polls: int = 0
    failures: int = 0
    refusals: int = 0
    skipped: int = 0
    vetoes: int = 0
    readings: int = 0
    commands: int = 0
    refused_commands: int = 0
    lateness: list[int] = field(
        default_factory=lambda: [0] * (len(LATENESS_BOUNDS) + 1), repr=False
    )
    late_seconds: float = field(default=0.0, repr=False)
    outputs: dict[str, OutputStatistics] = field(default_factory=dict, repr=False)
    journal: JournalStatistics | None = field(default=None, repr=False)
    worst: float = field(default=0.0, repr=False)

    def note_start(self, late: float) -> None:
        """Count a poll that began `late` seconds after its time."""
        self.lateness[bisect_left(LATENESS_BOUNDS, late)] += 1
        self.late_seconds += late
        if late > self.worst:
            self.worst = late

    def take_worst(self) -> float:
        """Return the greatest lateness since the last call, in seconds, and reset it."""
        worst, self.worst = self.worst, 0.0
        return worst

    def within(self, seconds: float) -> float:
        """Return the share of polls, 0..1, no later than one of the `LATENESS_BOUNDS`."""
        total = sum(self.lateness)
        return sum(self.lateness[: bisect_left(LATENESS_BOUNDS, seconds) + 1]) / (total or 1)
