"""
A gateway as a page shows it: its lines and their queues, units that are silent, and who asks what.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import (
    Context,
    Device,
    Gateway,
    GatewayTargetFailedToRespond,
    Mapping,
    Route,
    Server,
)
from libmodbus_py.ports.trace import Traced
from libmodbus_py.services.gateway import shown_gateway
from libmodbus_py.services.gateway.shown_gateway import ClientsTable, ShownGateway
from libmodbus_py.tools.page import row_history
from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.table_source import TableSource
from tests.tools.page.watching import Visitor, until


def cells(table: Any) -> dict[str, list[Any]]:
    """The cells of each row, by the name of the row."""
    return {" ".join(row[0][:2]).strip(): row for row in map(table.cells, table.rows())}


def traced(direction: Any, function: int, peer: str = "192.0.2.7:4711", unit: int = 3) -> Traced:
    return Traced(100.0, "tcp://0.0.0.0:502", direction, b"", unit, function, peer)


def test_who_asks_what_is_counted() -> None:
    table = ClientsTable()
    for peer in ("192.0.2.7:4711", "192.0.2.7:4712", "[2001:db8::1]:99", "/dev/ttyUSB0"):
        table.note(traced("received", 3, peer))
        table.note(traced("sent", 3, peer))
    table.note(traced("received", 16))
    table.note(traced("sent", 0x90))
    table.note(traced("received", 0x41))
    table.note(traced("sent", 0x83, "192.0.2.99:1"))  # to a request before the page
    table.note(traced("received", 3)._replace(unit=None, function=None))
    assert [table.cells(row)[:4] for row in table.rows()] == [
        [["/dev/ttyUSB0", "unit 3"], "3 read holding registers", 1, 0],
        [["192.0.2.7", "unit 3"], "3 read holding registers", 2, 0],
        [["192.0.2.7", "unit 3"], "16 write registers", 1, 1],
        [["192.0.2.7", "unit 3"], "65 ", 1, 0],
        [["2001:db8::1", "unit 3"], "3 read holding registers", 1, 0],
    ]
    assert [table.is_trouble(row) for row in table.rows()] == [False, False, True, False, False]


def test_clients_that_never_end_take_a_bounded_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shown_gateway, "MOST_ASKING", 10)
    table = ClientsTable()
    for at in range(1000):
        table.note(traced("received", 3, f"192.0.2.{at % 250}:1", unit=at % 200))
    assert len(table.rows()) == 10


def test_lines_units_and_clients_of_a_gateway_on_a_page() -> None:
    devices = {1: Device(Mapping(holding_registers=10))}
    with Server(devices, unknown_unit="silent").background("tcp://127.0.0.1:0") as behind:
        there, gone = behind.urls[0], "tcp://127.0.0.1:9"
        gateway = Gateway(
            [Route(f"{there}?timeout=0.05", units="1-2"), Route(gone, units="9")], longest_wait=1
        )
        shown = ShownGateway("house", gateway)
        lines, units, clients = shown.tables
        with (
            gateway.tracing(shown.note),
            gateway.background("tcp://127.0.0.1:0") as running,
            table_page(TableSource(shown)) as page,
            Visitor(page.url).watching() as visitor,
            Context.from_url(running.urls[0], unit=1, timeout=10) as plc,
        ):
            assert plc.read_holding_registers(3, 2) == [0, 0]
            for unit in (2, 9):
                with pytest.raises(GatewayTargetFailedToRespond):
                    plc.for_unit(unit).read_holding_registers(0, 1)
            rows = cells(lines)
            assert rows[there][1] == ["open", "", ""]
            assert rows[there][7:9] == [2, 1]
            down = until(lambda: (found := cells(lines)[gone])[1][0] == "down" and found)
            assert "Connection refused" in down[1][2]
            assert down[2] > 0
            assert [each.url for each in lines.rows() if lines.is_trouble(each)] == [gone]
            assert cells(units)[f"{there} unit 1"][1:4] == [["answers", ""], 1, 1]
            assert cells(units)[f"{there} unit 2"][1][0] == "silent"
            found = [clients.cells(row)[:4] for row in clients.rows()]
            assert [[each[0][1], *each[1:]] for each in found] == [
                ["unit 1", "3 read holding registers", 1, 0],
                ["unit 2", "3 read holding registers", 1, 1],
                ["unit 9", "3 read holding registers", 1, 1],
            ]
            visitor.receive(lambda: visitor.seen["figures"]["requests"] == 3)
            assert visitor.seen["figures"]["down"] == 1
            visitor.receive(lambda: len(visitor.seen["log"]) == 3)
            assert visitor.seen["log"][0][5] == "read holding registers 3..4"
            visitor.look_at("units", trouble=True)
            visitor.receive(lambda: visitor.seen["rows"])
            assert visitor.seen["rows"]["0"][0][1] == "unit 2"


def test_numbers_of_lines_and_units_over_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_history, "SAMPLED", 0.0)
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as behind:
        place = behind.urls[0]
        gateway = Gateway([Route(place, units="1-2")])
        shown = ShownGateway("house", gateway)
        with (
            gateway.tracing(shown.note),
            gateway.background("tcp://127.0.0.1:0") as running,
            Context.from_url(running.urls[0], unit=1) as plc,
        ):
            for _ in range(5):  # nobody looks at the page yet
                plc.read_holding_registers(0, 1)
        with table_page(TableSource(shown)) as page:
            visitor = Visitor(page.url)
            charts = {
                (table, column): visitor.history(list(name), 60, table, column)
                for table, name in (("lines", ("", place)), ("units", (place, "unit 1")))
                for column in ("rate", "queue", "time")
            }
            assert visitor.history(["127.0.0.1", "unit 1"], 60, "clients", "requests") == (
                "this value no longer exists"
            )
    assert max(charts["lines", "rate"]["values"]) > 0
    assert max(charts["units", "rate"]["values"]) > 0
    assert set(charts["lines", "queue"]["values"]) <= {0, 1}
    assert all(took is None or 0 < took < 60_000 for took in charts["units", "time"]["values"])
    units = {key: chart["units"] for key, chart in charts.items() if isinstance(chart, dict)}
    assert units == {
        ("lines", "rate"): "requests/s",
        ("lines", "queue"): "requests",
        ("units", "rate"): "requests/s",
        ("units", "time"): "ms",
    }
