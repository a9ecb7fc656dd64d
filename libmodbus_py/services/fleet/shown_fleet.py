"""
A fleet as it is shown: on a page with its outputs, devices and values; on a terminal as lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import Any, NamedTuple

from ...protocol.plain import clock_text
from ...tools.page import table_source
from ...tools.page.log import Log
from ...tools.page.samples import Series
from ...tools.page.text import cell_text, first_names, value_text
from .config import DeviceConfig
from .fleet import Fleet
from .outputs.output import Output
from .poller import DeviceState, Poller
from .readings import Reading
from .statistics import JournalStatistics, OutputStatistics


def problems(fleet: Fleet) -> list[str]:
    """
    Return what keeps readings from arriving, in words: devices that do not answer, or have not yet;
    points without a good value; outputs and a journal that fail, or are behind.
    """
    pollers = dict(fleet.devices)
    states = {name: poller.state for name, poller in pollers.items()}
    down = [name for name, state in states.items() if state is DeviceState.DOWN]
    new = [name for name, state in states.items() if state is DeviceState.NEW]
    bad = [f"{name} {point}" for name, poller in pollers.items() for point in poller.bad_points]
    texts = [f"{len(down)} of {len(pollers)} devices down{first_names(down)}"] if down else []
    if new:
        texts.append(
            f"{len(new)} of {len(pollers)} devices have not answered yet{first_names(new)}"
        )
    if bad:
        texts.append(f"points without a good value: {len(bad)}{first_names(bad)}")
    for row in destinations(fleet):
        if row.word == "fails":
            texts.append(f"{row.words} fails")
        elif row.word == "behind":
            texts.append(f"{row.words} is behind: {' '.join(row.amount.values())}")
    return texts


class PageOutput(Output):
    """An output whose readings a page shows; `fleet` is set before the first."""

    name = "page"
    is_live = True

    def __init__(self) -> None:
        self.fleet: Fleet | None = None
        self.values: table_source.Values = table_source.Values(self._device_row)
        self._is_new = True

    def describe_devices(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Take other points before the next readings: then the fleet has its new devices."""
        self._is_new = True

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        if self._is_new and self.fleet is not None:
            self._is_new = False
            self.values.describe(_points(self.fleet.devices))
        self.values.put_readings(readings)

    def _device_row(self, name: str) -> table_source.GroupRow:
        assert self.fleet is not None
        return PollerRow(self.fleet.devices[name])


def _points(devices: Mapping[str, Poller]) -> Iterator[table_source.ShownPoint]:
    for device in devices.values():
        config = device.config
        for name, units in zip(device.reads.names, device.reads.units, strict=True):
            is_stepped = config.on_change or name in config.dead_bands
            every = None if is_stepped else config.map[name].interval or config.interval
            yield table_source.ShownPoint(device.name, name, units, every)


class ShownFleet:
    """A fleet with a `PageOutput`, for a page; `older` finds readings of its journal."""

    kind = "fleet"
    log: Log | None = None
    columns: Sequence[table_source.Column] = table_source.COLUMNS

    def __init__(
        self, title: str, fleet: Fleet, output: PageOutput, older: table_source.Older | None = None
    ) -> None:
        self.title = title
        self.older = older
        self._fleet = fleet
        self._values = output.values
        output.fleet = fleet

    def status(self) -> tuple[str, bool]:
        """Return what keeps readings from arriving, or that all devices answer."""
        if texts := problems(self._fleet):
            return "; ".join(texts), True
        count = len(self._fleet.devices)
        return f"all {count} devices answer" if count else "no devices", False

    def figures(self) -> Mapping[str, float]:
        statistics = self._fleet.statistics
        names = ("devices", "up", "down", "polls", "readings")
        return {name: getattr(statistics, name) for name in names}

    def rows(self) -> Sequence[table_source.PageRow]:
        return [*destinations(self._fleet), *self._values.rows]

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        return self._values.series(name, column)


class DestinationRow(NamedTuple):
    """See `PageRow`: an output or the journal, its state, how much waits, and why it fails."""

    kind: str
    name: str
    word: str
    amount: dict[str, str]
    trouble: str
    since: float = 0

    @property
    def words(self) -> str:
        return f"{self.kind} {self.name}".strip().lower()

    @property
    def is_problem(self) -> bool:
        return self.word != "works"

    def cells(self) -> dict[str, Any]:
        reason, since = cell_text(self.trouble), round(self.since, 1)
        state = {"word": self.word, "reason": reason, "since": since}
        name = {"group": self.kind, "own": cell_text(self.name)}
        return {"name": name, "state": state, "value": self.amount}


def destinations(fleet: Fleet) -> list[DestinationRow]:
    """Return the outputs, but not the page of this program; and the journal."""
    outputs, journal = fleet.statistics.outputs.copy(), fleet.statistics.journal
    outputs.pop(PageOutput.name, None)
    rows = [_output_row(name, output) for name, output in outputs.items()]
    return rows if journal is None else [*rows, _journal_row(journal)]


def _output_row(name: str, output: OutputStatistics) -> DestinationRow:
    word = "fails" if output.is_failing else "behind" if output.is_behind else "works"
    since = output.trouble_since if output.is_failing else 0
    amount = {"text": f"{output.waiting:,}", "units": "waiting"}
    return DestinationRow("output", name, word, amount, output.trouble, since)


def _journal_row(journal: JournalStatistics) -> DestinationRow:
    word = "fails" if journal.is_failing else "works"
    amount = {"text": f"{journal.bytes / 1e6:.1f}", "units": "MB"}
    return DestinationRow("", "journal", word, amount, journal.trouble)


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

    def cells(self) -> dict[str, Any]:
        poller, config = self._poller, self._poller.config
        place = f"{config.endpoint}, unit {poller.unit}"
        # A device that answers, but refuses something, is "partly" there.
        word = "partly" if poller.is_refused else poller.state.value
        reason = "" if poller.error is None else table_source.problem_text(poller.error)
        points, every = f"{len(poller.reads.names)} points", f"every {config.interval:g} s"
        name = {"group": "", "own": cell_text(poller.name), "place": cell_text(place)}
        state = {"word": word, "reason": reason, "since": round(poller.since, 1)}
        row = {"name": name, "state": state, "value": {"text": points, "units": every}}
        return {**row, "age": round(poller.answered_at, 1)}


# --- on a terminal -----------------------------------------------------------------------------

MOST_LINES = 500  # more than a terminal shows
WIDEST = 30  # characters of a name
MAX_TEXT_CHARACTERS = 60  # of a value, so that its unit of measurement stays on the line


def fleet_lines(fleet: Fleet, title: str) -> list[tuple[str, bool]]:
    """Return the title, the devices that are down and the values, each with True if bold."""
    pollers = fleet.devices.values()
    lines = []
    for poller in pollers:
        if poller.state is DeviceState.DOWN:
            since, why = clock_text(poller.since), str(poller.error).rpartition("): ")[2]
            lines.append(f"{poller.name[:WIDEST]} is down since {since}: {why}")
    values = ((poller.name, value) for poller in pollers for value in poller.last_values())
    rows = list(islice(values, MOST_LINES))
    device_width = min(max((len(device) for device, _ in rows), default=0), WIDEST)
    name_width = min(max((len(value.name) for _, value in rows), default=0), WIDEST)
    for device, value in rows:
        text = f"- ({value.reason})" if value.reason else value_text(value.value)
        where = f"{device[:WIDEST]:<{device_width}}  {value.name[:WIDEST]:<{name_width}}"
        lines.append(f"{where}  {text[:MAX_TEXT_CHARACTERS]:>14} {value.units}".rstrip())
    if next(values, None) is not None:
        lines.append("...")
    return [(title, True), *((line, False) for line in lines)]
