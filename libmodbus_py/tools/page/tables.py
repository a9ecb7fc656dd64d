"""
The tables of a page: columns, rows, and the values with their samples.
"""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

from .samples import Samples, samples_of_each

__all__ = [
    "SPARK",
    "Column",
    "PageTable",
    "Series",
    "TableValue",
    "ValuesTable",
    "cell_text",
    "value_text",
]

MOST_TEXT = 200
"""The most characters of a cell."""

SPARK = 60
"""The most samples of a sparkline."""

MOST_VALUES = 20
"""The most items of a list that a cell shows."""


class Column(NamedTuple):
    """
    A column of a table.

    Attributes:
        title: the title of the column.
        kind: how its cells are shown: "row" names the row, "age" and "since" are times in seconds
            since the epoch, "state" is good or not, "spark" are the levels of a sparkline, which
            opens a chart.
        is_wide: True if narrow screens, such as those of telephones, leave the column out.
    """

    title: str
    kind: Literal["row", "text", "note", "value", "number", "age", "since", "state", "spark"] = (
        "text"
    )
    is_wide: bool = False


class Series(NamedTuple):
    """
    The numbers that a chart shows.

    Attributes:
        samples: the times and values.
        units: the units of measurement.
        is_stepped: True if a number is valid until the next one, because it is sampled on change.
    """

    samples: Samples
    units: str
    is_stepped: bool = False


class PageTable(Protocol):
    """
    A table, whose rows may be any objects. A thread of the page calls the methods.
    """

    @property
    def name(self) -> str:
        """The name by which requests choose it."""
        ...

    @property
    def title(self) -> str:
        """Its caption."""
        ...

    @property
    def columns(self) -> Sequence[Column]:
        """The columns of its cells."""
        ...

    def rows(self) -> Sequence[Any]:
        """Return the rows in order; the same object again unless they have changed."""
        ...

    def words(self, row: Any) -> str:
        """Return the text of a row that is searched, in lower case."""
        ...

    def is_trouble(self, row: Any) -> bool:
        """Return True if the row shows a problem."""
        ...

    def stamp(self, row: Any) -> object:
        """Return an object that is not equal to the last one if the cells may have changed."""
        ...

    def cells(self, row: Any) -> list[Any]:
        """Return a cell for each column."""
        ...

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        """
        Return the numbers of a sparkline; None if the row or column no longer exists.

        Args:
            name: the first two texts of the cell that names the row.
            column: the title of the column.
        """
        ...


class TableValue:
    """
    A named value.

    Attributes:
        device, name, units: the names of device and point, and the units of measurement.
        reading: time, device, name, value, unit, quality, reason, and perhaps more; None at first.
        samples: the last numbers of the value.
    """

    __slots__ = ("device", "name", "reading", "samples", "units")

    def __init__(self, device: str, name: str, units: str, samples: Samples) -> None:
        self.device: str = device
        self.name: str = name
        self.units: str = units
        self.reading: tuple[Any, ...] | None = None
        self.samples: Samples = samples


class ValuesTable:
    """
    A `PageTable` of the last value of each point. Any thread may call `put`.

    Args:
        seen: called with a device; returns when it last answered, in seconds since the epoch. A
            good value is as old as that, or as its reading if that is newer.
        is_stepped: called with device and name; see `Series`.
    """

    name: str = "values"
    title: str = "Values"
    columns: Sequence[Column] = (
        Column("point", "row"),
        Column("value", "value"),
        Column("unit"),
        Column("last values", "spark"),
        Column("lowest", "number", is_wide=True),
        Column("highest", "number", is_wide=True),
        Column("quality", "state", is_wide=True),
        Column("age", "age", is_wide=True),
    )

    def __init__(
        self,
        seen: Callable[[str], float] = lambda device: 0.0,
        is_stepped: Callable[[str, str], bool] = lambda device, name: False,
    ) -> None:
        self._seen = seen
        self._is_stepped = is_stepped
        self._values: dict[tuple[str, str], TableValue] = {}
        self._rows: list[TableValue] = []

    def describe(self, points: Iterable[tuple[str, str, str]]) -> None:
        """
        Set the points of the table, and keep the values of those that it already contains.

        Args:
            points: device, name and units of each point.
        """
        before, after = self._values, dict[tuple[str, str], TableValue]()
        given = list(points)
        most = samples_of_each(len(given))
        for device, name, units in given:
            value = before.get((device, name)) or TableValue(device, name, units, Samples(most))
            value.units = units
            value.samples.resize(most)
            after[device, name] = value
        self._values, self._rows = after, list(after.values())

    def put(self, readings: Iterable[tuple[Any, ...]]) -> None:
        """Take readings, each with the fields of `TableValue.reading`."""
        values = self._values
        for each in readings:
            value = values.get((each[1], each[2]))
            if value is not None:
                value.reading = each
                value.samples.add(each[0], each[3])

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        value = self._values.get(name)
        if value is None:
            return None
        return Series(value.samples, value.units, self._is_stepped(*name))

    # --- the table -----------------------------------------------------------------------------

    def rows(self) -> list[TableValue]:
        return self._rows

    def words(self, row: TableValue) -> str:
        return f"{row.device} {row.name} {row.units}".lower()

    def is_trouble(self, row: TableValue) -> bool:
        return row.reading is not None and row.reading[5] != "good"

    def stamp(self, row: TableValue) -> object:
        return row.reading, self._seen(row.device)

    def cells(self, row: TableValue) -> list[Any]:
        reading, samples = row.reading, row.samples
        names = [cell_text(row.device), cell_text(row.name)]
        if reading is None:
            return [names, None, cell_text(row.units), [], None, None, ["new", ""], 0]
        is_good = reading[5] == "good"
        age = max(reading[0], self._seen(row.device)) if is_good else reading[0]
        return [
            names,
            value_text(reading[3]) if reading[3] is not None else "-",
            cell_text(row.units),
            samples.spark(SPARK),
            None if samples.low is None else value_text(samples.low),
            None if samples.high is None else value_text(samples.high),
            [reading[5], cell_text(reading[6])],
            round(age, 1),
        ]


# Characters of a number that is shown to the last digit.
LONGEST = 12


def cell_text(text: object) -> str:
    """Return a text for a cell: cut, and without characters that cannot be printed."""
    found = text if isinstance(text, str) else str(text)
    cut = found[:MOST_TEXT]
    plain = cut if cut.isprintable() else "".join(x if x.isprintable() else "?" for x in cut)
    return plain if len(found) <= MOST_TEXT else f"{plain}..."


def value_text(value: Any) -> str:
    """Return a value as text, of at most about `MOST_TEXT` characters."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        # A longer number was decoded from 32 bits, which hold only seven exact digits.
        return text if len(text := repr(value)) <= LONGEST else f"{value:.7g}"
    if isinstance(value, list | tuple):
        more = ", ..." if len(value) > MOST_VALUES else ""
        return cell_text(", ".join("-" if x is None else value_text(x) for x in value[:20]) + more)
    if isinstance(value, dict):
        return cell_text(" ".join(f"{name}={value_text(each)}" for name, each in value.items()))
    if isinstance(value, int | str):
        return cell_text(value)
    return cell_text(reprlib.repr(value))
