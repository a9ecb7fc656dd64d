"""
Rows of values with their samples, each device's below a row of the device.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple, Protocol

from .samples import SPARK, Samples, Series, samples_of_each
from .table_source import Column, PageRow
from .text import cell_text, value_text

__all__ = ["COLUMNS", "GroupRow", "ShownPoint", "Values", "problem_text"]

COLUMNS = (
    Column("name", "row"),
    Column("state", "state"),
    Column("value", "value"),
    Column("last values", "spark"),
    Column("lowest", "number", is_wide=True),
    Column("highest", "number", is_wide=True),
    Column("age", "age", is_wide=True),
)
"""The columns of pages of values."""


class GroupRow(PageRow, Protocol):
    """
    The row of a device, whose columns are `COLUMNS`.

    Attributes:
        is_down: True if the device does not answer.
        answered_at: when it last answered, in seconds since the epoch; 0 before.
    """

    @property
    def is_down(self) -> bool: ...

    @property
    def answered_at(self) -> float: ...


class ShownPoint(NamedTuple):
    """
    A point.

    Attributes:
        device, name, units: the names of device and point, and the units of measurement.
        every: seconds between two values; None if a value comes only when it has changed.
    """

    device: str
    name: str
    units: str
    every: float | None


class ValueRow:
    """
    See `PageRow`: the last value of a point.

    Attributes:
        point: the point.
        device: the row of its device.
        reading: time, device, name, value, unit, quality, reason, and perhaps more; None at first.
        samples: the last numbers of the value.
    """

    __slots__ = ("device", "point", "reading", "samples")

    def __init__(self, point: ShownPoint, device: GroupRow, samples: Samples) -> None:
        self.point: ShownPoint = point
        self.device: GroupRow = device
        self.reading: tuple[Any, ...] | None = None
        self.samples: Samples = samples

    @property
    def words(self) -> str:
        return f"{self.point.device} {self.point.name} {self.point.units}".lower()

    @property
    def is_problem(self) -> bool:
        """True if there is no good value, although the device answers."""
        return self.reading is not None and self.reading[5] != "good" and not self.device.is_down

    def cells(self) -> list[Any]:
        point, reading, samples = self.point, self.reading, self.samples
        names, units = [cell_text(point.device), cell_text(point.name)], cell_text(point.units)
        if reading is None:
            return [names, ["new", "", 0], ["", units], [], "", "", 0]
        is_good = reading[5] == "good"
        age = max(reading[0], self.device.answered_at) if is_good else reading[0]
        reason = "" if self.device.is_down else in_words(reading[6])
        return [
            names,
            [reading[5], reason, 0],
            ["-" if reading[3] is None else value_text(reading[3]), units],
            samples.spark(SPARK),
            "" if samples.low is None else value_text(samples.low),
            "" if samples.high is None else value_text(samples.high),
            round(age, 1),
        ]


class Values:
    """
    The rows of devices and their values. Any thread may call `put`.

    Args:
        device_row: returns the row of a device, by its name.

    Attributes:
        rows: the rows in order.
    """

    def __init__(self, device_row: Callable[[str], GroupRow]) -> None:
        self._device_row = device_row
        self._values: dict[tuple[str, str], ValueRow] = {}
        self.rows: list[PageRow] = []

    def describe(self, points: Iterable[ShownPoint]) -> None:
        """Set the points, each device's together, and keep the values of those that stay."""
        before, rows, after = self._values, list[PageRow](), dict[Any, ValueRow]()
        given = list(points)
        most, device = samples_of_each(len(given)), None
        for point in given:
            if device is None or device[0] != point.device:
                device = point.device, self._device_row(point.device)
                rows.append(device[1])
            key = point.device, point.name
            row = before.get(key) or ValueRow(point, device[1], Samples(point.every, most))
            row.point, row.device, row.samples.every = point, device[1], point.every
            row.samples.resize(most)
            rows.append(row)
            after[key] = row
        self._values, self.rows = after, rows

    def put(self, readings: Iterable[tuple[Any, ...]]) -> None:
        """Take readings, each with the fields of `ValueRow.reading`."""
        values = self._values
        for each in readings:
            value = values.get((each[1], each[2]))
            if value is not None:
                value.reading = each
                value.samples.add(each[0], each[3])

    def series(self, name: tuple[str, str], column: str) -> Series | None:
        """Return the numbers of a value; None if there is no such value."""
        value = self._values.get(name)
        return None if value is None else Series(value.samples, value.point.units)


def in_words(reason: str) -> str:
    """Return the name of an error as words: "IllegalDataAddress" is "illegal data address"."""
    plain = re.sub("^Modbus|Error$", "", reason)
    return cell_text(re.sub("(?<=[a-z])(?=[A-Z])", " ", plain).lower())


def problem_text(error: Exception | str) -> str:
    """Return the reason in the text of an error, without the request before it."""
    text = str(error) or type(error).__name__
    return cell_text(text.rpartition("): ")[2])
