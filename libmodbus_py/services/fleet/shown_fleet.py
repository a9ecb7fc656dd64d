"""
A fleet as a page shows it: its values, and the state of its devices.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from ...tools.page.table_source import Older
from ...tools.page.tables import Column, PageTable, Series, ValuesTable, cell_text
from .config import DeviceConfig
from .fleet import Fleet
from .poller import DeviceState, Poller
from .readings import Reading

__all__ = ["DevicesTable", "PageOutput", "ShownFleet"]


class PageOutput:
    """
    An output whose readings a page shows.

    Attributes:
        values: what it was given.
        fleet: whose readings they are; set before the first.
        is_live: True, because readings of earlier runs are not wanted.
    """

    name: str = "page"
    is_live = True

    def __init__(self) -> None:
        self.fleet: Fleet | None = None
        self.values: ValuesTable = ValuesTable(self._answered_at, self._is_stepped)
        self._is_new = True

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Note that the fleet has other devices from now on."""
        self._is_new = True

    async def open(self) -> None:
        """Do nothing: there is no connection."""

    async def write(self, readings: Sequence[Reading]) -> None:
        if self._is_new and self.fleet is not None:
            self._is_new = False
            self.values.describe(_points(self.fleet.devices.values()))
        self.values.put(readings)

    async def close(self) -> None:
        """Do nothing: there is no connection."""

    def _answered_at(self, device: str) -> float:
        poller = None if self.fleet is None else self.fleet.devices.get(device)
        return 0.0 if poller is None else poller.answered_at

    def _is_stepped(self, device: str, name: str) -> bool:
        """Return True if a value is reported only when it has changed."""
        poller = None if self.fleet is None else self.fleet.devices.get(device)
        return poller is not None and (poller.config.on_change or name in poller.config.dead_bands)


class ShownFleet:
    """
    See `Shown` of the page.

    Args:
        title: the name of the fleet.
        fleet: it must have the output.
        output: the output whose readings are shown.
        older: finds readings that are not in memory any more; None without a journal.
    """

    kind = "fleet"
    log = None

    def __init__(
        self, title: str, fleet: Fleet, output: PageOutput, older: Older | None = None
    ) -> None:
        self.title = title
        self.older = older
        self._fleet = fleet
        self.tables: Sequence[PageTable] = (output.values, DevicesTable(fleet))
        output.fleet = fleet

    def figures(self) -> Mapping[str, float]:
        found = self._fleet.statistics
        return {
            "devices": found.devices,
            "up": found.up,
            "down": found.down,
            "polls": found.polls,
            "readings": found.readings,
        }


class DevicesTable:
    """See `PageTable`: the state of each device, since when, and why."""

    name: str = "devices"
    title: str = "Devices"
    columns: Sequence[Column] = (
        Column("device", "row"),
        Column("state", "state"),
        Column("since", "since"),
        Column("answered", "age", is_wide=True),
        Column("unit", "number", is_wide=True),
        Column("interval", "number", is_wide=True),
        Column("points", "number", is_wide=True),
    )

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._rows: list[Poller] = []

    def rows(self) -> list[Poller]:
        rows = list(dict(self._fleet.devices).values())  # a copy in one step: the fleet goes on
        if rows != self._rows:
            self._rows = rows
        return self._rows

    def words(self, row: Poller) -> str:
        return f"{row.name} {row.config.endpoint}".lower()

    def is_trouble(self, row: Poller) -> bool:
        return row.state is DeviceState.DOWN or row.error is not None

    def stamp(self, row: Poller) -> object:
        return row.state, row.error, row.answered_at

    def cells(self, row: Poller) -> list[Any]:
        config = row.config
        return [
            ["", cell_text(row.name), cell_text(str(config.endpoint))],
            [_state(row), *_reasons(row.error)],
            round(row.since, 1),
            round(row.answered_at, 1),
            row.unit,
            f"{config.interval:g} s",
            len(row.reads.names),
        ]

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return None


def _state(row: Poller) -> str:
    """Return a word for the state; "partly" for a device that answers, but refuses something."""
    return "partly" if row.is_refused else row.state.value


def _reasons(error: Exception | None) -> list[str]:
    """Return why, without the request, and the whole text of an error."""
    if error is None:
        return ["", ""]
    text = str(error) or type(error).__name__
    return [cell_text(text.rpartition("): ")[2]), cell_text(text)]


def _points(devices: Iterable[Poller]) -> Iterable[tuple[str, str, str]]:
    """Yield device, name and unit of each point."""
    for each in devices:
        for name, unit in zip(each.reads.names, each.reads.units, strict=True):
            yield each.name, name, unit
