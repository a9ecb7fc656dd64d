"""
The log names points, with scaled values and units; it is filtered, and saved as CSV that no
spreadsheet takes for formulas.
"""

from __future__ import annotations

import contextlib
import csv
import io
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Context, IllegalDataAddress, Server
from libmodbus_py.page import live_page
from libmodbus_py.protocol import pdu
from libmodbus_py.tools.page.log import Log
from libmodbus_py.tools.page.named import named_cells
from libmodbus_py.tools.page.shown import ShownServer, shown_of
from tests.support.cases import each_case
from tests.tools.page.watching import Visitor, made_server, shown


@each_case(
    ("request_", "response", "text"),
    [
        (pdu.ReadHoldingRegisters(2, 1), [125], "level 12.5 m"),
        (pdu.ReadHoldingRegisters(1, 2), [0, 125], "level 12.5 m"),  # half of the temperature
        (pdu.ReadHoldingRegisters(0, 3), [0, 16812, 125], "temperature 21.5 °C, level 12.5 m"),
        (pdu.WriteRegister(2, 40), None, "level 4.0 m"),
        (pdu.WriteRegisters(7, (1, 0xFFFF)), None, "limits 1, -1"),
        (pdu.ReadCoils(0, 8), [True] + [False] * 7, "pump on"),
        (pdu.WriteCoil(0, False), None, "pump off"),
        (pdu.ReadWriteRegisters(2, 1, 7, (1, 2)), [10], "limits 1, 2, level 1.0 m"),
        (pdu.MaskWriteRegister(2, 0, 50), None, "level 5.0 m"),
        (pdu.ReadHoldingRegisters(2, 1), None, ""),
        (pdu.ReadHoldingRegisters(500, 1), [1], ""),
        (pdu.ReportServerId(), None, ""),
        (pdu.ReadFifoQueue(2), [1, 2], ""),
    ],
)
def test_points_of_requests(request_: Any, response: Any, text: str) -> None:
    unit = shown_of(made_server()).units[1]
    assert named_cells(unit, request_, response) == text


@contextlib.contextmanager
def talked() -> Iterator[Visitor]:
    """A visitor of a server to which a client wrote, and that refused something."""
    with shown() as (_, url, visitor), Context.from_url(url, timeout=5) as plc, visitor.watching():
        plc.for_unit(1).write_register(2, 125)
        plc.for_unit(1).read_holding_registers(2, 1)
        with pytest.raises(IllegalDataAddress):
            plc.for_unit(2).read_holding_registers(60, 1)
        plc.for_unit(2).write_register(0, 1)
        visitor.receive(lambda: len(visitor.seen["log"]) == 4)
        yield visitor


def saved(visitor: Visitor, query: str) -> list[list[str]]:
    status, headers, data = visitor.ask("GET", f"/log.csv{query}")
    assert (status, headers["Content-Type"]) == (200, "text/csv; charset=utf-8")
    return list(csv.reader(io.StringIO(data.decode())))


@each_case(
    ("query", "rows"),
    [
        ("", [0, 1, 2, 3]),
        ("?unit=1", [0, 1]),
        ("?writes=1", [0, 3]),
        ("?errors=1", [2]),
        ("?writes=1&errors=1", [0, 2, 3]),
        ("?unit=2&writes=1", [3]),
        ("?unit=99", []),
        ("?nonsense=%00&unit=", [0, 1, 2, 3]),
    ],
)
def test_what_is_chosen_is_saved(query: str, rows: list[int]) -> None:
    with talked() as visitor:
        every = saved(visitor, "")
        assert every[0][:6] == ["time", "client", "unit", "function", "request", "points"]
        assert every[1][2:8] == [
            *("1", "6", "write holding registers 2: 125", "level 12.5 m", "done", "answered"),
        ]
        assert saved(visitor, query) == [every[0], *(every[1 + at] for at in rows)]
        named = [(each[9], each[10]) for each in visitor.seen["log"]]
        assert named[:2] == [("level 12.5 m", True), ("level 12.5 m", False)]


def test_who_may_not_look_may_not_save() -> None:
    with shown() as (_, _, visitor):
        assert visitor.ask("GET", "/log.csv", Cookie=None)[0] == 403
        assert visitor.ask("GET", "/log.csv?" + "&a=1" * 20)[0] == 400


def test_no_cell_is_a_formula() -> None:
    log = Log(lambda: ShownServer({}, {}))
    log.rows()
    row = log_row(named="=HYPERLINK(1)", peer="@x")
    log._rows.append(row)
    cells = next(csv.reader(log.as_csv().splitlines()[1:]))
    assert (cells[1], cells[5]) == ("'@x", "'=HYPERLINK(1)")


def log_row(**given: Any) -> Any:
    from libmodbus_py.tools.page.log import LogRow

    return LogRow(1, 0.0, "", 1, 3, "", "", "answered", None)._replace(**given)


def test_counters_are_numbers() -> None:
    with live_page(Server({})) as page, Visitor(page.url).watching() as visitor:
        counters = visitor.receive(lambda: visitor.seen.get("counters"))
        assert all(isinstance(each, int) for each in counters.values())
