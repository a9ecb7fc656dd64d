"""
The live page of a server: what it shows, sets and switches, asked as a browser asks.
"""

from __future__ import annotations

import socket
import threading

import pytest

from libmodbus_py import (
    Context,
    Device,
    Fault,
    Mapping,
    ModbusTimeoutError,
    Server,
    ServerDeviceBusy,
)
from libmodbus_py.page import live_page
from tests.tools.page.watching import NAMES, Visitor, made_server, shown, until


def test_everything_there_is_comes_first() -> None:
    with shown() as (_, _, visitor), visitor.watching():
        first, second = visitor.seen["units"]
    assert (first["number"], second["number"]) == (1, 2)
    assert first["name"] == "tank <script>alert(1)</script>"
    assert first["description"] == "a & b"
    assert first["tables"] == {
        "coils": [[0, 16]],
        "discrete_inputs": [[0, 4]],
        "holding_registers": [[0, 20], [100, 110]],
        "input_registers": [[0, 8]],
    }
    assert [each[0] for each in first["points"]] == NAMES
    assert first["points"][0][1:5] == ["holding_registers", 0, "float32 CDAB", "°C"]
    assert second["points"] == []
    assert visitor.seen["counters"]["requests"] == 0


def test_points_are_shown_with_their_values_and_change() -> None:
    with shown() as (_, url, visitor), visitor.watching():
        visitor.look(1, "points", 0, 100)
        texts = visitor.receive(lambda: len(visitor.seen["points"]) == 6 and visitor.seen["points"])
        assert texts == {"0": "21.5", "1": "0.0", "2": "abc", "3": "0, 0", "4": "off", "5": "0"}
        with Context.from_url(url, unit=1) as plc:
            plc.write_registers(2, [123])
            plc.write_coil(0, True)
            visitor.receive(lambda: (texts["1"], texts["4"]) == ("12.3", "on"))


def test_cells_are_shown_as_far_as_they_are_looked_at() -> None:
    with shown() as (_, url, visitor), visitor.watching():
        visitor.look(1, "holding_registers", 100, 110)
        cells = visitor.receive(lambda: visitor.seen["cells"])
        assert cells == dict.fromkeys(range(100, 110), 0)
        with Context.from_url(url, unit=1) as plc:
            plc.write_registers(2, [123])
            plc.write_registers(104, [7])
        visitor.receive(lambda: cells[104] == 7)
        assert sorted(cells) == list(range(100, 110))
        visitor.look(1, "coils", 0, 4)
        visitor.receive(lambda: visitor.seen["what"] == "coils")
        assert visitor.seen["unit"] == 1


def test_the_server_itself_is_its_only_device() -> None:
    server = Server({7: Device(Mapping(holding_registers=8))})
    with live_page(server) as page, server.background("tcp://127.0.0.1:0") as running:
        visitor = Visitor(page.url)
        with visitor.watching(), Context.from_url(running.urls[0], unit=255) as plc:
            plc.write_register(1, 1)
            visitor.receive(lambda: visitor.seen["written"])
    assert visitor.seen["written"][0][1:3] == [7, "holding_registers"]


def test_faults_are_switched_off_and_on() -> None:
    faults = {1: [Fault("exception", code=6, function=3)], None: [Fault("no_answer", function=1)]}
    with (
        shown(faults=faults) as (_, url, visitor),
        visitor.watching(),
        Context.from_url(url, unit=1, timeout=5) as plc,
    ):
        assert visitor.seen["faults"] == [
            [0, 1, "exception", "function 3, code 6", True],
            [1, None, "no_answer", "function 1", True],
        ]
        with pytest.raises(ServerDeviceBusy):
            plc.read_holding_registers(0, 1)
        assert visitor.post("/fault", number=0, on=False) == {}
        visitor.receive(lambda: not visitor.seen["faults"][0][4])
        until(lambda: _reads(plc))
        visitor.post("/fault", number=0, on=True)
        until(lambda: not _reads(plc))
        found = visitor.post("/fault", number=9, on=True)
        assert found == "there is no such fault any more"


def _reads(plc: Context) -> bool:
    try:
        plc.read_holding_registers(0, 1)
    except ServerDeviceBusy:
        return False
    return True


def test_a_fault_is_added() -> None:
    with shown() as (server, url, visitor), visitor.watching():
        body = {"unit": 2, "kind": "no_answer", "function": 3, "every": None, "seconds": None}
        assert visitor.post("/faults", **body) == {}
        visitor.receive(lambda: visitor.seen["faults"])
        (state,) = server.fault_switch.states()
        assert (state.unit, state.fault) == (2, Fault("no_answer", function=3))
        with Context.from_url(url, unit=2, timeout=0.3) as plc, pytest.raises(ModbusTimeoutError):
            until(lambda: plc.read_holding_registers(0, 1) is None)
    for wrong, text in (
        ({"unit": 2, "kind": "delay"}, "seconds is missing"),
        ({"unit": None, "kind": "explode"}, "kind must be one of delay"),
        ({"unit": 3, "kind": "no_answer"}, "there is no unit 3"),
        ({"unit": 2, "kind": "delay", "seconds": "soon"}, "seconds must be"),
        ({"unit": 2, "kind": ["delay"]}, "kind must be one of"),
    ):
        with shown() as (_, _, visitor):
            assert text in visitor.post("/faults", **wrong)


def test_others_may_change_devices_and_faults() -> None:
    with shown() as (server, _, visitor), visitor.watching():
        visitor.look(1, "holding_registers", 0, 8)
        visitor.receive(lambda: visitor.seen["cells"])
        mapping = Mapping(holding_registers={0: [77] * 8})
        server.replace({1: Device(mapping)}, {1: [Fault("no_answer")]})
        visitor.receive(lambda: visitor.seen["cells"][0] == 77 and visitor.seen["faults"])
        assert [each["number"] for each in visitor.seen["units"]] == [1]
        assert visitor.seen["units"][0]["tables"] == {"holding_registers": [[0, 8]]}
        server.replace({3: Device(mapping)})
        visitor.receive(lambda: visitor.seen["units"][0]["number"] == 3)
        visitor.look(3, "holding_registers", 0, 8)
        visitor.receive(lambda: visitor.seen["unit"] == 3)


def test_nothing_is_left_behind() -> None:
    before = threading.active_count()
    with shown() as (_, _, visitor), visitor.watching():
        pass
    with live_page(made_server()):
        pass
    until(lambda: threading.active_count() == before)


def test_an_address_that_is_taken() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        page = live_page(made_server(), port=taken.getsockname()[1])
        with pytest.raises(OSError, match="in use"):
            page.__enter__()
    server = made_server()
    with live_page(server) as one, live_page(server) as other:  # two of one server
        assert one.url != other.url
