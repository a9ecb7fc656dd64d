"""
The tables of a gateway on a page, cell by cell, from counters that a test sets.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py.client.statistics import Statistics
from libmodbus_py.ports.trace import Traced
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.services.gateway import shown_gateway
from libmodbus_py.services.gateway.shown_gateway import (
    ClientsTable,
    LinesTable,
    ShownGateway,
    UnitsTable,
)
from libmodbus_py.services.gateway.statistics import GatewayStatistics, LineStatistics

FIRST, SECOND = "tcp://10.0.0.1", "rtu:///dev/line"


class Counted:
    """
    What a page looks at of a gateway, with two lines; seconds pass when the test says so.
    """

    def __init__(self) -> None:
        self.lines = [LineStatistics(url, Statistics()) for url in (FIRST, SECOND)]
        self.traffic = GatewayStatistics({each.url: each for each in self.lines})
        self.statistics = ServerStatistics()
        self.now = 1000.0

    def table(self, made: type[Any]) -> Any:
        table = made(self)
        table.history._clock = lambda: self.now
        return table


def test_a_line_has_its_counters_and_its_state() -> None:
    counted = Counted()
    table = counted.table(LinesTable)
    line = counted.lines[0]
    line.since, line.waiting, line.in_flight, line.full = 12.34, 5, 2, 3
    line.connection.requests, line.connection.responses = 70, 60
    assert table.cells(line) == [*(["", FIRST], ["new", "", ""], 12.3, 5, 2, [], [], 70, 60, 3)]
    line.connection.connects = 1
    assert table.cells(line)[1] == ["open", "", ""]
    assert not table.is_trouble(line)
    line.trouble = f"{FIRST} (unit 1): it is gone"
    assert table.cells(line)[1] == ["down", "it is gone", line.trouble]
    assert table.is_trouble(line)
    assert table.words(counted.lines[1]) == SECOND


def test_rows_of_lines_are_new_ones_only_if_a_line_is() -> None:
    counted = Counted()
    table = LinesTable(counted)  # type: ignore[arg-type]
    before = table.rows()
    assert before == counted.lines
    assert table.rows() is before
    counted.traffic.lines[SECOND] = LineStatistics(SECOND, Statistics())
    again = table.rows()
    assert again[1] is counted.traffic.lines[SECOND]
    assert table.rows() is again
    del counted.traffic.lines[FIRST]
    assert len(table.rows()) == 1


@pytest.mark.parametrize("table", [LinesTable, UnitsTable, ClientsTable])
def test_each_change_of_a_counter_is_shown(table: Any) -> None:
    """A row is sent again when its stamp is another one."""
    counted = Counted()
    unit = counted.lines[0].unit(1)
    clients = ClientsTable()
    clients.note(Traced(1.0, "", "received", b"", 1, 3, "192.0.2.7:1"))
    made = clients if table is ClientsTable else table(counted)
    (row, *_) = made.rows()
    line = counted.lines[0]
    changes: dict[Any, list[tuple[Any, str, Any]]] = {
        LinesTable: [
            *((line, name, 7) for name in ("waiting", "in_flight")),
            (line.connection, "requests", 7),
            (line, "trouble", "gone"),
        ],
        UnitsTable: [
            *((unit, name, 7) for name in ("requests", "answers", "resting", "cached")),
            (unit, "is_silent", True),
        ],
        ClientsTable: [(row, "requests", 7), (row, "exceptions", 7)],
    }
    for holder, name, value in changes[table]:
        before = made.stamp(row)
        assert made.stamp(row) == before
        setattr(holder, name, value)
        assert made.stamp(row) != before, name


def test_a_unit_has_its_counters_and_its_state() -> None:
    counted = Counted()
    table = counted.table(UnitsTable)
    unit = counted.lines[0].unit(3)
    (row,) = table.rows()
    unit.requests, unit.timeouts, unit.invalid, unit.resting, unit.cached = 9, 2, 3, 4, 5
    name = [FIRST, "unit 3"]
    assert table.cells(row) == [name, ["new", ""], 9, 0, 0, 2, 3, 4, 5, "", [], []]
    unit.answers, unit.exceptions, unit.seconds = 4, 1, 0.5
    assert table.cells(row)[1:5] == [["answers", ""], 9, 4, 1]
    assert table.cells(row)[9] == "125.0 ms"
    assert not table.is_trouble(row)
    unit.is_silent = True
    assert table.cells(row)[1] == ["silent", "4 refused meanwhile"]
    assert table.is_trouble(row)
    assert table.words(row) == f"{FIRST} unit 3"


def test_units_stand_in_the_order_of_their_lines_and_numbers() -> None:
    counted = Counted()
    for line, unit in ((0, 9), (1, 4), (0, 2)):
        counted.lines[line].unit(unit)
    table = UnitsTable(counted)  # type: ignore[arg-type]
    rows = table.rows()
    assert [row[:2] for row in rows] == [(SECOND, 4), (FIRST, 2), (FIRST, 9)]
    assert table.rows() is rows
    counted.lines[0].unit(5)
    assert [row[1] for row in table.rows()] == [4, 2, 5, 9]


def test_numbers_over_time_are_those_of_the_time_between() -> None:
    before, now = shown_gateway.UnitCounts(100, 90, 2.0), shown_gateway.UnitCounts(130, 100, 2.2)
    assert shown_gateway._unit_figures(before, now, 4.0) == {"rate": 7.5, "time": 20.0}
    one = shown_gateway.UnitCounts(101, 91, 2.0012345)
    assert shown_gateway._unit_figures(before, one, 3.0) == {"rate": 0.33, "time": 1.23}
    # Without an answer there is no time; after a change of routes counters may have begun again.
    assert shown_gateway._unit_figures(now, before, 4.0) == {"rate": 0, "time": None}
    assert shown_gateway._unit_figures(now, now, 4.0) == {"rate": 0, "time": None}
    counts = shown_gateway.LineCounts
    assert shown_gateway._line_figures(counts(5, 1), counts(11, 2), 4.0) == {
        "rate": 1.5,
        "queue": 2,
    }


def test_a_client_was_there_when_it_last_asked() -> None:
    table = ClientsTable()
    for at, direction in ((10.04, "received"), (20.06, "received"), (30.0, "sent")):
        table.note(Traced(at, "", direction, b"", 1, 3, "192.0.2.7:1"))  # type: ignore[arg-type]
    (row,) = table.rows()
    assert table.cells(row)[2:] == [2, 0, 20.1]
    assert table.words(row) == "192.0.2.7 unit 1 function 3 read holding registers"


def test_the_client_that_came_first_is_dropped_for_one_too_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shown_gateway, "MOST_ASKING", 2)
    table = ClientsTable()
    for last in (1, 2, 1, 3):
        table.note(Traced(1.0, "", "received", b"", 1, 3, f"192.0.2.{last}:1"))
    assert [row.host for row in table.rows()] == ["192.0.2.2", "192.0.2.3"]
    assert table.rows() is table.rows()


def test_the_figures_are_the_sums_of_all_lines() -> None:
    counted = Counted()
    shown: Any = ShownGateway("house", counted)  # type: ignore[arg-type]
    assert set(shown.figures().values()) == {0}
    counted.statistics.connections, counted.traffic.requests = 3, 40
    counted.traffic.refused, counted.traffic.no_route, counted.traffic.malformed = 1, 20, 300
    counted.lines[0].waiting, counted.lines[1].waiting = 4, 6
    counted.lines[1].trouble = "gone"
    expected = {"clients": 3, "requests": 40, "waiting": 10, "refused": 321, "down": 1}
    assert shown.figures() == expected
    assert shown.title == "house"
    assert [table.name for table in shown.tables] == ["lines", "units", "clients"]


def test_samples_are_taken_although_nobody_looks() -> None:
    counted = Counted()
    shown: Any = ShownGateway("house", counted)  # type: ignore[arg-type]
    counted.lines[0].unit(1)
    lines, units, _ = shown.tables
    for table in (lines, units):
        table.history._clock = lambda: counted.now
    for requests in (0, 4, 10):
        counted.lines[0].connection.requests = counted.lines[0].unit(1).requests = requests
        counted.lines[0].waiting = 2
        shown.note(Traced(1.0, "", "received", b"", 1, 3, "192.0.2.7:1"))
        counted.now += 2.0
    assert lines.cells(counted.lines[0])[5] != []
    assert lines.series(("", FIRST), "rate") is not None
    assert units.series((FIRST, "unit 1"), "time") is not None
    assert units.series((FIRST, "unit 2"), "time") is None
