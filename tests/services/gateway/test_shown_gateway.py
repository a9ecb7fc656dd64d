"""A gateway on a page: its lines and their queues, silent units, and who asks what."""

from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Gateway,
    GatewayTargetFailedToRespond,
    Mapping,
    Route,
    Server,
)
from libmodbus_py.client.statistics import Statistics
from libmodbus_py.ports.trace import TracedFrame
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.services.gateway.shown_gateway import Clients, ShownGateway
from libmodbus_py.services.gateway.statistics import GatewayStatistics, LineStatistics
from libmodbus_py.tools.page import samples
from libmodbus_py.tools.page.page import table_page
from libmodbus_py.tools.page.table_source import TableSource
from tests.support.peers import until
from tests.tools.page.tables import name_of, state_of
from tests.tools.page.watching import Visitor

FIRST, SECOND = "tcp://10.0.0.1", "rtu:///dev/line"


def rows(view: Any) -> dict[str, Any]:
    """Return the rows by their names."""
    return {" ".join(name_of(row.cells())[:2]): row for row in view.rows()}


def cells(view: Any) -> dict[str, dict[str, Any]]:
    return {name: row.cells() for name, row in rows(view).items()}


def problems(view: Any) -> list[str]:
    return [name for name, row in rows(view).items() if row.is_problem]


def traced(
    direction: Any, function: int, peer: str = "192.0.2.7:4711", unit: int = 3
) -> TracedFrame:
    return TracedFrame(100.04, "tcp://0.0.0.0:502", direction, b"", unit, function, peer)


class Counted:
    """What a page looks at of a gateway, with two lines."""

    def __init__(self) -> None:
        self.lines = [LineStatistics(url, Statistics()) for url in (FIRST, SECOND)]
        self.traffic = GatewayStatistics({line.url: line for line in self.lines})
        self.statistics = ServerStatistics()
        self.shown: Any = ShownGateway("house", self)  # type: ignore[arg-type]


def test_a_line_is_shown_with_its_counters_and_state() -> None:
    counted = Counted()
    line = counted.lines[0]
    line.since, line.waiting, line.in_flight, line.full = 12.34, 5, 2, 3
    line.connection.requests = 70
    line.connection.answer_times[0] = 60
    assert cells(counted.shown)[FIRST] == {
        "name": {"group": "", "own": FIRST},
        "state": {"word": "new", "reason": "", "since": 12.3},
        "requests": 70,
        "answers": 60,
        "rate": [],
        "queue": [],
        "details": "waiting 5, in flight 2, refused 3",
    }
    line.connection.connects = 1
    assert state_of(cells(counted.shown)[FIRST]) == ["open", "", 12.3]
    assert problems(counted.shown) == []
    assert counted.shown.status() == ("no line is down", False)
    line.trouble = f"{FIRST} (unit 1): it is gone"
    assert state_of(cells(counted.shown)[FIRST]) == ["down", "it is gone", 12.3]
    assert problems(counted.shown) == [FIRST]
    assert counted.shown.status() == (f"1 of 2 lines down ({FIRST})", True)
    assert rows(counted.shown)[SECOND].words == SECOND


def test_a_unit_is_shown_with_its_counters_and_state() -> None:
    counted = Counted()
    name, unit = f"{FIRST} unit 3", counted.lines[0].unit(3)
    unit.requests, unit.timeouts, unit.invalid, unit.refused, unit.cached = 9, 2, 3, 4, 5
    details = "timeouts 2, invalid 3, refused 4, cached 5"
    assert cells(counted.shown)[name] == {
        "name": {"group": FIRST, "own": "unit 3"},
        "state": {"word": "no answer", "reason": ""},
        "requests": 9,
        "answers": 0,
        "rate": [],
        "time": [],
        "details": details,
    }
    assert problems(counted.shown) == [name]
    assert counted.shown.status() == (f"units that have never answered: 1 ({name})", True)
    unit.answers, unit.exceptions, unit.seconds = 4, 1, 0.5
    assert state_of(cells(counted.shown)[name]) == ["answers", "", 0]
    assert cells(counted.shown)[name]["details"] == f"mean 125.0 ms, exceptions 1, {details}"
    assert problems(counted.shown) == []
    unit.is_silent = True
    assert state_of(cells(counted.shown)[name]) == ["silent", "4 requests refused meanwhile", 0]
    assert problems(counted.shown) == [name]
    assert counted.shown.status() == (f"silent units: 1 ({name})", True)
    assert rows(counted.shown)[name].words == name


def test_requests_are_counted_by_client_and_unit() -> None:
    clients = Clients()
    for peer in ("192.0.2.7:4711", "192.0.2.7:4712", "[2001:db8::1]:99", "/dev/ttyUSB0"):
        clients.note(traced("received", 3, peer))
        clients.note(traced("sent", 3, peer))
    clients.note(traced("received", 16))
    clients.note(traced("sent", 0x90))
    clients.note(traced("received", 0x41))
    clients.note(traced("sent", 0x83, "192.0.2.99:1"))  # to a request before the page
    clients.note(traced("received", 3)._replace(unit=None, function=None))
    read, write = "unit 3, 3 read holding registers", "unit 3, 16 write registers"
    rows_ = [row.cells() for row in clients.rows()]
    assert [(name_of(row), *state_of(row)[:2], row["requests"]) for row in rows_] == [
        (["/dev/ttyUSB0", read], "client", "", 1),
        (["192.0.2.7", read], "client", "", 2),
        (["192.0.2.7", write], "client", "exceptions 1", 1),
        (["192.0.2.7", "unit 3, 65"], "client", "", 1),
        (["2001:db8::1", read], "client", "", 1),
    ]
    assert rows_[0]["last"] == 100.0
    assert [row.is_problem for row in clients.rows()] == [False, False, True, False, False]
    assert clients.rows()[1].words == "192.0.2.7 unit 3, 3 read holding registers function 3"


def test_a_page_shows_lines_and_units_and_clients_of_a_gateway(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(samples, "SAMPLED", 0.0)
    devices = {1: Device(Mapping(holding_registers=10))}
    with Server(devices, unknown_unit="silent").background("tcp://127.0.0.1:0") as behind:
        there, absent = behind.urls[0], "tcp://127.0.0.1:9"
        gateway = Gateway(
            [Route(f"{there}?timeout=0.05", units="1-2"), Route(absent, units="9")], longest_wait=1
        )
        view = ShownGateway("house", gateway)
        with (
            gateway.tracing(view.note),
            gateway.background("tcp://127.0.0.1:0") as running,
            Client(running.urls[0], unit=1, timeout=10) as plc,
            table_page(TableSource(view)) as page,
        ):
            # No page is open yet.
            assert plc.read_holding_registers(3, 2) == [0, 0]
            for unit in (2, 9):
                with pytest.raises(GatewayTargetFailedToRespond):
                    plc.for_unit(unit).read_holding_registers(0, 1)
            table = cells(view)
            assert state_of(table[there])[:2] == ["open", ""]
            assert (table[there]["requests"], table[there]["answers"]) == (2, 1)
            down = until(lambda: (now := state_of(cells(view)[absent]))[0] == "down" and now)
            assert "Connection refused" in down[1]
            assert down[2] > 0
            assert state_of(table[f"{there} unit 1"]) == ["answers", "", 0]
            assert state_of(table[f"{there} unit 2"])[0] == "silent"
            with Visitor(page.url).watching() as visitor:
                visitor.receive(lambda: visitor.seen["figures"]["requests"] == 3)
                visitor.receive(lambda: len(visitor.rows("log")) == 3)
                assert visitor.rows("log")[0]["asked"] == "read holding registers 3..4"
                visitor.look_at(problems=True)
                read = "3 read holding registers"
                visitor.receive(lambda: len(visitor.rows("rows")) == 4)
                assert [name_of(row)[-1] for row in visitor.rows("rows")] == [
                    *("unit 2", absent, f"unit 2, {read}", f"unit 9, {read}")
                ]
                rate = visitor.history(["", there], 60, "rate")
                assert (rate["units"], rate["values"] != []) == ("requests/s", True)
                took = visitor.history([there, "unit 1"], 60, "time")
                assert took["units"] == "ms"
                reason = visitor.history(["127.0.0.1", "unit 1"], 60, "requests")
                assert reason == "this value no longer exists"
