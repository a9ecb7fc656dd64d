"""
A page as a whole: what it shows first, what changes on it, and its end.
"""

from __future__ import annotations

import socket
import threading

import pytest

from libmodbus_py import Context, Device, Mapping, Server
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
