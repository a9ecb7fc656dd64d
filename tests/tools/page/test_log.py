"""
Who wrote last, and the log of requests.
"""

from __future__ import annotations

import socket

import pytest

from libmodbus_py import Context, IllegalDataAddress
from tests.tools.page.watching import shown


def test_who_wrote_what_last() -> None:
    with shown() as (_, url, visitor), visitor.watching():
        with Context.from_url(url, unit=1) as plc:
            plc.write_registers(100, [1, 2, 3])
            plc.write_coil(5, True)
            plc.mask_write_register(101, 0xFFFF, 0)
            plc.read_write_registers(0, 1, 8, [4, 5])
            with pytest.raises(IllegalDataAddress):
                plc.write_register(50, 1)
        visitor.receive(lambda: len(visitor.seen["written"]) == 4)
        visitor.post("/value", unit=2, table="holding_registers", address=3, text="9", type="int16",
                     order="ABCD")  # fmt: skip
        visitor.receive(lambda: len(visitor.seen["written"]) == 5)
    found = [(each[1], each[2], each[3], each[4]) for each in visitor.seen["written"]]
    assert found == [
        (1, "holding_registers", 100, 103),
        (1, "coils", 5, 6),
        (1, "holding_registers", 101, 102),
        (1, "holding_registers", 8, 10),
        (2, "holding_registers", 3, 4),
    ]
    assert visitor.seen["written"][0][6].startswith("127.0.0.1:")
    assert visitor.seen["written"][4][6] == "this page"


def test_the_log_is_text() -> None:
    with shown() as (_, url, visitor), visitor.watching():
        with Context.from_url(url, unit=1) as plc:
            plc.read_holding_registers(100, 3)
            plc.write_coils(3, [True, False])
            plc.report_server_id()
            with pytest.raises(IllegalDataAddress):
                plc.read_coils(60, 10)
        with socket.create_connection(("127.0.0.1", int(url.rpartition(":")[2]))) as noisy:
            noisy.sendall(bytes.fromhex("000100000300"))
            visitor.receive(lambda: len(visitor.seen["log"]) == 5)
        counters = visitor.receive(
            lambda: visitor.seen["counters"]["requests"] and visitor.seen["counters"]
        )
    texts = [(each[3], each[5], each[7]) for each in visitor.seen["log"]]
    assert texts == [
        (1, "read holding registers 100..102", "answered"),
        (1, "write coils 3..4: 1, 0", "answered"),
        (1, "report server id", "answered"),
        (1, "read coils 60..69", "exception"),
        (None, "", "damaged"),
    ]
    assert visitor.seen["log"][0][6] == "0, 0, 0"
    assert "illegal data address" in visitor.seen["log"][3][6].lower()
    assert (counters["requests"], counters["refused"]) == (4, 1)
