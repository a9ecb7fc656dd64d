"""
Who wrote last, and the log of requests: it names points, is filtered, and is saved as CSV that no
spreadsheet takes for formulas.
"""

import contextlib
import csv
import io
import socket
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Client, IllegalDataAddress
from libmodbus_py.protocol import pdu
from libmodbus_py.tools.page.log import Log, LogRow, named_cells
from libmodbus_py.tools.page.units import ShownServer, shown_of
from tests.support.cases import each_case
from tests.tools.page.watching import Visitor, make_server, page_of


def test_the_log_has_the_last_writer_of_each_cell() -> None:
    with page_of() as (_, url, visitor), visitor.watching():
        with Client(url, unit=1) as plc:
            plc.write_registers(100, [1, 2, 3])
            plc.write_coil(5, True)
            plc.mask_write_register(101, 0xFFFF, 0)
            plc.read_write_registers(0, 1, 8, [4, 5])
            with pytest.raises(IllegalDataAddress):
                plc.write_register(50, 1)
        visitor.receive(lambda: len(visitor.rows("written")) == 4)
        visitor.post("/value", unit=2, table="holding_registers", address=3, text="9", type="int16",
                     order="ABCD")  # fmt: skip
        visitor.receive(lambda: len(visitor.rows("written")) == 5)
    writers = [
        (row["unit"], row["table"], row["start"], row["stop"]) for row in visitor.rows("written")
    ]
    assert writers == [
        (1, "holding_registers", 100, 103),
        (1, "coils", 5, 6),
        (1, "holding_registers", 101, 102),
        (1, "holding_registers", 8, 10),
        (2, "holding_registers", 3, 4),
    ]
    assert visitor.rows("written")[0]["who"].startswith("127.0.0.1:")
    assert visitor.rows("written")[4]["who"] == "this page"


def test_the_log_is_shown_as_text() -> None:
    with page_of() as (_, url, visitor), visitor.watching():
        with Client(url, unit=1) as plc:
            plc.read_holding_registers(100, 3)
            plc.write_coils(3, [True, False])
            plc.report_server_id()
            with pytest.raises(IllegalDataAddress):
                plc.read_coils(60, 10)
        with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2]))) as noisy:
            noisy.sendall(bytes.fromhex("000100000300"))
            visitor.receive(lambda: len(visitor.rows("log")) == 5)
        counters = visitor.receive(
            lambda: visitor.seen["counters"]["requests"] and visitor.seen["counters"]
        )
    texts = [(row["unit"], row["asked"], row["kind"]) for row in visitor.rows("log")]
    assert texts == [
        (1, "read holding registers 100..102", "answered"),
        (1, "write coils 3..4: 1, 0", "answered"),
        (1, "report server id", "answered"),
        (1, "read coils 60..69", "exception"),
        (None, "", "damaged"),
    ]
    assert visitor.rows("log")[0]["outcome"] == "0, 0, 0"
    assert "illegal data address" in visitor.rows("log")[3]["outcome"].lower()
    assert (counters["requests"], counters["refused"]) == (4, 1)


@each_case(
    ("request_", "response", "text"),
    [
        (pdu.ReadHoldingRegisters(2, 1), [125], "level 12.5 m"),
        (pdu.ReadHoldingRegisters(1, 2), [0, 125], "level 12.5 m"),  # half of the temperature
        (pdu.ReadHoldingRegisters(0, 3), [0, 16812, 125], "temperature 21.5 °C, level 12.5 m"),
        (pdu.WriteRegister(2, 40), None, "level 4.0 m"),
        (pdu.WriteRegisters(7, (1, 0xFFFF)), None, "limits 1, -1"),
        (pdu.WriteCoil(0, False), None, "pump off"),
        (pdu.ReadWriteRegisters(2, 1, 7, (1, 2)), [10], "limits 1, 2, level 1.0 m"),
        (pdu.MaskWriteRegister(2, 0, 50), None, "level 5.0 m"),
        (pdu.ReadHoldingRegisters(2, 1), None, ""),
        (pdu.ReadFifoQueue(2), [1, 2], ""),
    ],
)
def test_the_log_contains_the_point_names_of_requests(request_: Any, response: Any, text: str):
    unit = shown_of(make_server()).units[1]
    assert named_cells(unit, request_, response) == text


@contextlib.contextmanager
def visitor_of() -> Iterator[Visitor]:
    """A visitor of a server to which a client wrote, and that refused something."""
    with page_of() as (_, url, visitor), Client(url, timeout=5) as plc, visitor.watching():
        plc.for_unit(1).write_register(2, 125)
        plc.for_unit(1).read_holding_registers(2, 1)
        with pytest.raises(IllegalDataAddress):
            plc.for_unit(2).read_holding_registers(60, 1)
        plc.for_unit(2).write_register(0, 1)
        visitor.receive(lambda: len(visitor.rows("log")) == 4)
        yield visitor


def saved(visitor: Visitor, query: str) -> list[list[str]]:
    status, headers, data = visitor.ask("GET", f"/log.csv{query}")
    assert (status, headers["Content-Type"]) == (200, "text/csv; charset=utf-8")
    return list(csv.reader(io.StringIO(data.decode())))


def test_the_saved_log_has_the_selected_rows() -> None:
    with visitor_of() as visitor:
        every = saved(visitor, "")
        assert every[0][:6] == ["time", "client", "unit", "function", "request", "points"]
        assert every[1][2:8] == [
            *("1", "6", "write holding registers 2: 125", "level 12.5 m", "done", "answered")
        ]
        for query, rows in (
            ("?unit=1", [0, 1]),
            ("?writes=1", [0, 3]),
            ("?errors=1", [2]),
            ("?writes=1&errors=1", [0, 2, 3]),
            ("?unit=2&writes=1", [3]),
            ("?unit=99", []),
            ("?nonsense=%00&unit=", [0, 1, 2, 3]),
        ):
            assert saved(visitor, query) == [every[0], *(every[1 + at] for at in rows)], query
        names = [(row["named"], row["writes"]) for row in visitor.rows("log")]
        assert names[:2] == [("level 12.5 m", True), ("level 12.5 m", False)]


def test_no_cell_of_the_log_is_a_formula() -> None:
    log = Log(lambda: ShownServer({}, {}))
    row = LogRow(1, 0.0, "@x", 1, 3, "", "", "answered", None, named="=HYPERLINK(1)")
    log._rows.append(row)
    cells = next(csv.reader(log.download({}).splitlines()[1:]))
    assert (cells[1], cells[5]) == ("'@x", "'=HYPERLINK(1)")
