"""A page as a whole: what it shows first, what changes on it, other pages, and its end."""

import pytest

from libmodbus_py import (
    Access,
    Client,
    Device,
    IllegalDataAddress,
    Mapping,
    Server,
    ServerDeviceBusy,
)
from libmodbus_py.page import live_page
from tests.tools.page.watching import NAMES, Visitor, make_server, page_of

TOKEN = "Bookmarked-by_the-plant-2026"


def test_the_first_message_has_all_tables() -> None:
    with page_of() as (_, _, visitor), visitor.watching():
        first, second = visitor.rows("units")
    assert (first["number"], second["number"]) == (1, 2)
    assert first["name"] == "tank <script>alert(1)</script>"
    assert first["description"] == "a & b"
    assert first["tables"] == {
        "coils": [[0, 16]],
        "discrete_inputs": [[0, 4]],
        "holding_registers": [[0, 20], [100, 110]],
        "input_registers": [[0, 8]],
    }
    assert [point["name"] for point in first["points"]] == NAMES
    keys = ("table", "address", "type", "units")
    shown_keys = [first["points"][0][key] for key in keys]
    assert shown_keys == ["holding_registers", 0, "float32 CDAB", "°C"]
    assert second["points"] == []
    assert visitor.seen["counters"]["requests"] == 0
    assert all(isinstance(row, int) for row in visitor.rows("counters"))


def test_a_page_gets_points_with_values_and_then_only_changes() -> None:
    with page_of() as (_, url, visitor), visitor.watching():
        visitor.look(1, "points", 0, 100)
        visitor.receive(lambda: visitor.points("1/points"))
        assert visitor.points("1/points") == ["21.5", "0.0", "abc", "0, 0", "off", "0"]
        before = len(visitor.messages)
        with Client(url, unit=1) as plc:
            plc.write_registers(2, [123])
            visitor.receive(lambda: visitor.points("1/points")[1] == "12.3")
        rows = [item["1/points"] for item in visitor.messages[before:] if "1/points" in item]
        keys = {key for entry in rows for key, row in entry.items() if row["text"] != "abc"}
        assert keys == {"1"}


def test_a_page_gets_only_the_cells_in_view() -> None:
    with page_of() as (_, url, visitor), visitor.watching():
        visitor.look(1, "holding_registers", 100, 110)
        cells = visitor.receive(lambda: visitor.cells("1/holding_registers"))
        assert {cells[at] for at in range(100, 110)} == {0}
        assert 2 not in cells
        with Client(url, unit=1) as plc:
            plc.write_registers(2, [123])
            plc.write_registers(104, [7])
        visitor.receive(lambda: visitor.cells("1/holding_registers")[104] == 7)
        visitor.look(1, "coils", 0, 4)
        visitor.receive(lambda: "1/coils" in visitor.seen)
        assert "1/holding_registers" not in visitor.seen
        visitor.look(1, "holding_registers", 500, 600)
        visitor.receive(lambda: visitor.seen.get("1/holding_registers") == {})


def test_a_single_device_has_the_unit_of_the_server() -> None:
    server = Server({7: Device(Mapping(holding_registers=8))})
    with live_page(server) as page, server.background("tcp://127.0.0.1:0") as running:
        visitor = Visitor(page.url)
        with visitor.watching(), Client(running.urls[0], unit=255) as plc:
            plc.write_register(1, 1)
            visitor.receive(lambda: visitor.seen["written"])
    assert visitor.rows("written")[0]["unit"] == 7


def test_two_pages_of_a_server_with_one_token_work_independently() -> None:
    server = make_server()
    with live_page(server, token=TOKEN) as second, Visitor(second.url).watching() as other:
        with live_page(server, token=TOKEN) as first:
            one = Visitor(first.url)
            # A browser sends the cookies of all ports of a host to each of them.
            one.headers["Cookie"] = f"{one.headers['Cookie']}; {other.headers['Cookie']}"
            assert one.ask("GET", "/", Origin=f"http://{other.host}")[0] == 403
            with one.watching():
                # Streams of one page are unknown to the other.
                view = {"unit": 1, "what": "coils", "first": 0, "stop": 1}
                assert other.post("/view", stream=one.seen["page"]["stream"], **view) != {}
                place = {"unit": 2, "table": "holding_registers", "address": 3, "order": "ABCD"}
                for entry in (one, other):
                    entry.look(2, "holding_registers", 0, 8)
                assert one.post("/value", **place, type="uint16", text="1234") == {}
                one.receive(lambda: one.cells("2/holding_registers").get(3) == 1234)
        other.receive(lambda: other.cells("2/holding_registers").get(3) == 1234)


def test_a_moving_value_is_computed_when_it_is_shown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("libmodbus_py.tools.page.units.RETRY", 0.3)
    mapping, is_busy = Mapping(holding_registers=8, input_registers=8), True
    accesses: list[Access] = []

    def compute(access: Access) -> None:
        touched = range(access.address, access.address + access.count)
        if 3 in touched:
            raise IllegalDataAddress("clients may not read it")
        if 6 in touched and is_busy:
            raise ServerDeviceBusy
        accesses.append(access)
        for address in {4, 6} & {*touched}:
            mapping.input_registers[address] += 1

    with live_page(server := Server(Device(mapping, before_read=compute))) as page:
        visitor = Visitor(page.url)
        with visitor.watching():
            assert not accesses
            visitor.look(None, "input_registers", 0, 8)
            visitor.receive(lambda: visitor.cells("every/input_registers").get(4, 0) >= 3)
            assert visitor.cells("every/input_registers")[6] == 0
            is_busy = False
            visitor.receive(lambda: visitor.cells("every/input_registers")[6] > 0)
        count = len(accesses)
        assert {access.table for access in accesses} == {"input_registers"}
        assert server.statistics.requests == 0
    assert len(accesses) <= count + 8  # nothing is computed when nobody looks


@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit])
def test_a_hook_that_fails_is_logged_once_and_the_page_continues(error, caplog) -> None:
    def broken(access: Access) -> None:
        raise error

    mapping = Mapping(coils=8)
    with live_page(Server(Device(mapping, before_read=broken))) as page:
        visitor = Visitor(page.url)
        with visitor.watching():
            visitor.look(None, "coils", 0, 8)
            visitor.receive(lambda: visitor.cells("every/coils"))
            mapping.coils[3] = True
            visitor.receive(lambda: visitor.cells("every/coils")[3] == 1)
            body = {"unit": None, "table": "coils", "address": 5, "text": "on"}
            assert visitor.post("/value", **body, type="", order="ABCD") == {}
            visitor.receive(lambda: visitor.cells("every/coils")[5] == 1)
    assert [record.getMessage() for record in caplog.records] == [
        "coils range(0, 8): before_read failed"
    ]
