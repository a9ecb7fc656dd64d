"""
A fleet as it is shown: on a page with its outputs, devices and values; on a terminal as lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from ...protocol.plain import clock_text
from ...tools.page.log import Log
from ...tools.page.samples import Series
from ...tools.page.table_source import (
    COLUMNS,
    Column,
    GroupRow,
    Older,
    PageRow,
    ShownPoint,
    Values,
    problem_text,
)
from ...tools.page.text import cell_text, value_text
from .config import DeviceConfig
from .fleet import Fleet
from .poller import DeviceState, Poller
from .readings import Reading
from .statistics import KeptReadings, LastValues

__all__ = ["PageOutput", "ShownFleet", "fleet_lines"]


class PageOutput:
    """An output whose readings a page shows; `fleet` is set before the first."""

    name: str = "page"
    is_live = True

    def __init__(self) -> None:
        self.fleet: Fleet | None = None
        self.values: Values = Values(self._device_row)
        self._is_new = True

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Take other points before the next readings: then the fleet has its new devices."""
        self._is_new = True

    async def open(self) -> None:
        """Do nothing: there is no connection."""

    async def write(self, readings: Sequence[Reading]) -> None:
        if self._is_new and self.fleet is not None:
            self._is_new = False
            self.values.describe(_points(self.fleet.devices))
        self.values.put(readings)

    async def close(self) -> None:
        """Do nothing: there is no connection."""

    def _device_row(self, name: str) -> GroupRow:
        assert self.fleet is not None
        return PollerRow(self.fleet.devices[name])


def _points(devices: Mapping[str, Poller]) -> Iterator[ShownPoint]:
    for each in devices.values():
        config = each.config
        for name, units in zip(each.reads.names, each.reads.units, strict=True):
            is_stepped = config.on_change or name in config.dead_bands
            every = None if is_stepped else config.map[name].interval or config.interval
            yield ShownPoint(each.name, name, units, every)


class ShownFleet:
    """A fleet with a `PageOutput`, for a page; `older` finds readings of its journal."""

    kind = "fleet"
    log: Log | None = None
    columns: Sequence[Column] = COLUMNS

    def __init__(
        self, title: str, fleet: Fleet, output: PageOutput, older: Older | None = None
    ) -> None:
        self.title = title
        self.older = older
        self._fleet = fleet
        self._values = output.values
        output.fleet = fleet

    def status(self) -> tuple[str, bool]:
        """Return which devices and outputs fail, or that none does."""
        found = self._fleet.statistics
        problems = [f"{found.down} of {found.devices} devices down"] if found.down else []
        problems += [f"{each.words} fails" for each in self._destinations() if each.is_problem]
        if problems:
            return "; ".join(problems), True
        count = f"all {found.up}" if found.up == found.devices else f"{found.up} of {found.devices}"
        return f"{count} devices answer", False

    def figures(self) -> Mapping[str, float]:
        found = self._fleet.statistics
        names = ("devices", "up", "down", "polls", "readings")
        return {name: getattr(found, name) for name in names}

    def rows(self) -> Sequence[PageRow]:
        return [*self._destinations(), *self._values.rows]

    def _destinations(self) -> list[DestinationRow]:
        """Return the outputs, but not the page and metrics of this program; and the journal."""
        found = self._fleet.statistics
        rows = []
        for name, each in found.outputs.copy().items():
            if name not in (PageOutput.name, LastValues.name):
                waiting = [f"{each.waiting:,}", "waiting"]
                row = DestinationRow("output", name, waiting, each.trouble, each.trouble_since)
                rows.append(row)
        if found.journal is not None:
            size = [f"{found.journal.bytes / 1e6:.1f}", "MB"]
            rows.append(DestinationRow("", "journal", size, found.journal.trouble))
        return rows

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return self._values.series(name, column)


class DestinationRow(NamedTuple):
    """See `PageRow`: an output or the journal, how much it contains, and why it fails."""

    kind: str
    name: str
    amount: list[str]
    trouble: str
    since: float = 0

    @property
    def words(self) -> str:
        return f"{self.kind} {self.name}".strip().lower()

    @property
    def is_problem(self) -> bool:
        return bool(self.trouble)

    def cells(self) -> list[Any]:
        state = ["works", "", 0]
        if self.trouble:
            state = ["fails", cell_text(self.trouble), round(self.since, 1)]
        return [[self.kind, cell_text(self.name)], state, self.amount, None, "", "", 0]


class PollerRow:
    """See `GroupRow`: the state of a device, since when, and why."""

    def __init__(self, poller: Poller) -> None:
        self._poller = poller

    @property
    def is_down(self) -> bool:
        return self._poller.state is DeviceState.DOWN

    @property
    def answered_at(self) -> float:
        return self._poller.answered_at

    @property
    def words(self) -> str:
        return f"{self._poller.name} {self._poller.config.endpoint}".lower()

    @property
    def is_problem(self) -> bool:
        return self._poller.error is not None

    def cells(self) -> list[Any]:
        poller, config = self._poller, self._poller.config
        place = f"{config.endpoint}, unit {poller.unit}"
        # A device that answers, but refuses something, is "partly" there.
        word = "partly" if poller.is_refused else poller.state.value
        reason = "" if poller.error is None else problem_text(poller.error)
        return [
            ["", cell_text(poller.name), cell_text(place)],
            [word, reason, round(poller.since, 1)],
            [f"{len(poller.reads.names)} points", f"every {config.interval:g} s"],
            *(None, "", "", round(poller.answered_at, 1)),
        ]


# --- on a terminal -----------------------------------------------------------------------------

MOST_LINES = 500
"""More than a terminal shows."""

WIDEST = 30
"""Characters of a name."""

MAX_TEXT_CHARACTERS = 60
"""Of a value, so that its unit of measurement stays on the line."""


def fleet_lines(fleet: Fleet, kept: KeptReadings, title: str) -> list[tuple[str, bool]]:
    """Return the title, the devices that are down and the values, each with True if bold."""
    lines = []
    for poller in fleet.devices.values():
        if poller.state is DeviceState.DOWN:
            since, why = clock_text(poller.since), str(poller.error).rpartition("): ")[2]
            lines.append(f"{poller.name[:WIDEST]} is down since {since}: {why}")
    readings = [each for each in kept.by_name.copy().values() if each.quality != "down"]
    shown = readings[:MOST_LINES]
    device = min(max((len(each.device) for each in shown), default=0), WIDEST)
    name = min(max((len(each.name) for each in shown), default=0), WIDEST)
    for each in shown:
        text = value_text(each.value) if each.quality == "good" else f"- ({each.reason})"
        where = f"{each.device[:WIDEST]:<{device}}  {each.name[:WIDEST]:<{name}}"
        lines.append(f"{where}  {text[:MAX_TEXT_CHARACTERS]:>14} {each.unit}".rstrip())
    if len(readings) > MOST_LINES:
        lines.append(f"... {len(readings) - MOST_LINES} more")
    return [(title, True), *((line, False) for line in lines)]
