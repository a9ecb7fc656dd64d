"""Values typed on a page: set, or refused with the reason; held values; and faults."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Access, Client, Device, Fault, Mapping, ModbusTimeoutError, Server
from libmodbus_py.page import live_page
from libmodbus_py.tools.simulator.device_file import load
from libmodbus_py.tools.simulator.simulated import SimulatedDevice
from tests.support.golden import Refused
from tests.support.peers import until
from tests.tools.page.watching import NAMES, Visitor, is_served, page_of

H = "holding_registers"

VALUES: list[tuple[str, str, str]] = [
    ("temperature", "-3.25", "-3.25"),
    ("temperature", "nan", "- (Missing)"),
    ("level", "12.34", "12.3"),
    ("label", "Kessel", "Kessel"),
    ("limits", "-5, 7", "-5, 7"),
    ("pump", "on", "on"),
    ("flow", "0x10000", "65536"),
]


def test_typed_values_are_set() -> None:
    with page_of() as (_, _, visitor), visitor.watching():
        visitor.look(1, "points", 0, 100)
        visitor.receive(lambda: visitor.rows("1/points"))
        for name, typed, text in VALUES:
            point = NAMES.index(name)
            assert visitor.post("/value", unit=1, point=point, name=name, text=typed) == {}
            visitor.receive(lambda at=point, to=text: visitor.points("1/points")[at] == to)


def test_a_value_set_on_the_page_is_read_by_clients() -> None:
    with page_of() as (_, url, visitor), Client(url, unit=1) as plc:
        visitor.post("/value", unit=1, point=0, name="temperature", text="3.5")
        assert plc.read_values("holding_registers", 0, "float32", order="CDAB") == [3.5]
        place = {"unit": 1, "table": "holding_registers", "order": "ABCD"}
        visitor.post("/value", **place, address=100, type="int32", text="-2")
        assert plc.read_holding_registers(100, 2) == [0xFFFF, 0xFFFE]
        visitor.post("/value", **place, address=100, type="uint16", text="-3")
        assert plc.read_holding_registers(100, 1) == [0xFFFD]
        visitor.post(
            "/value", unit=1, table="discrete_inputs", order="ABCD", address=2, type="", text="on"
        )
        assert plc.read_discrete_inputs(0, 4) == [False, False, True, False]


def cell(**changes: Any) -> dict[str, Any]:
    place = {"unit": 1, "table": "holding_registers", "address": 0, "text": "1"}
    return {**place, "type": "uint16", "order": "ABCD", **changes}


def test_an_invalid_change_is_reported(refused: Refused) -> None:
    with page_of() as (_, _, visitor):
        refused("refused.txt", visitor.refused)


def test_a_value_that_the_device_computes_cannot_be_set() -> None:
    mapping = Mapping(input_registers=4)

    def compute(access: Access) -> None:
        mapping.input_registers[1] = 42

    with live_page(Server({1: Device(mapping, before_read=compute)})) as page:
        visitor = Visitor(page.url)
        body = cell(table="input_registers", address=1, text="7")
        assert visitor.post("/value", **body) == "the device computes this value itself"
        assert visitor.post("/value", **{**body, "address": 2}) == {}
    assert mapping.input_registers[:] == [0, 42, 7, 0]


def test_the_page_shows_the_values_that_registers_may_have() -> None:
    with page_of() as (_, _, visitor):
        reading = visitor.post("/readings", unit=1, table="holding_registers", address=0)
        assert {"type": "float32", "order": "CDAB", "text": "21.5"} in reading["readings"]
        for place in ({"table": "coils", "address": 0}, {"table": H, "address": 60}):
            assert visitor.post("/readings", unit=1, **place) == {"readings": []}


PLANT = """
[[unit]]
id = 1
holding_registers = [
    { address = 0, name = "level", counter = { start = 10, step = 1, interval = 0.05 } },
    { address = 1, name = "fixed", value = 7 },
]
"""


@pytest.fixture
def visitor(tmp_path: Path) -> Iterator[Visitor]:
    (tmp_path / "plant.toml").write_text(PLANT)
    simulation = load(tmp_path / "plant.toml")
    with live_page(Server(simulation.devices)) as page, Visitor(page.url).watching() as visitor:
        visitor.look(1, "points", 0, 9)
        yield visitor


def test_a_held_value_can_be_set_and_moves_again_after_its_release(visitor: Visitor) -> None:
    level = {"unit": 1, "point": 0, "name": "level"}

    def row() -> tuple[str, bool | None, list[int]]:
        empty = {"text": "", "moves": None, "spark": []}
        point = visitor.seen.get("1/points", {"0": empty})["0"]
        return point["text"], point["moves"], point["spark"]

    visitor.receive(lambda: row()[1])
    before = row()[0]
    visitor.receive(lambda: row()[0] != before)
    refusal = visitor.post("/value", **level, text="5")
    assert refusal == "level: the device computes this value itself"

    assert visitor.post("/hold", **level, on=True) == {}
    visitor.receive(lambda: row()[1] is False)
    assert visitor.post("/value", **level, text="5") == {}
    visitor.receive(lambda: row()[0] == "5")
    samples = len(row()[2])
    visitor.receive(lambda: len(row()[2]) > samples + 1)  # time passes
    assert row()[0] == "5"

    assert visitor.post("/hold", **level, on=False) == {}
    visitor.receive(lambda: int(row()[0]) > 10)
    assert row()[1] is True
    history = visitor.post("/history", row=[1, "level"], seconds=60)
    assert 5 in history["values"]
    assert len(history["times"]) == len(history["values"])


def device_of(file: Path) -> SimulatedDevice:
    devices = load(file).devices
    return devices if isinstance(devices, SimulatedDevice) else devices[1]


def test_a_held_value_stays_held_after_its_file_was_read_again(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(PLANT)
    before = device_of(file)
    with pytest.raises(ValueError, match="fixed: never moves by itself"):
        before.hold(before.points["fixed"], is_on=True)
    before.hold(before.points["level"], is_on=True)
    before["level"] = 33
    file.write_text(PLANT.replace("value = 7", "value = 8"))
    after = device_of(file)
    after.take_state_of(before)
    assert (after["level"], after.movement(after.points["level"])) == (33, False)
    after.hold(after.points["level"], is_on=False)
    assert after["level"] != 33


GIVEN = {1: [Fault("exception", code=6, function=3)], None: [Fault("no_answer", function=1)]}


def test_faults_are_switched_off_and_on() -> None:
    with (
        page_of(faults=GIVEN) as (_, url, visitor),
        visitor.watching(),
        Client(url, unit=1, timeout=5) as plc,
    ):
        assert visitor.rows("faults") == [
            {"unit": 1, "kind": "exception", "settings": "function 3, code 6", "is_on": True},
            {"unit": None, "kind": "no_answer", "settings": "function 1", "is_on": True},
        ]
        number = min(map(int, visitor.seen["faults"]))
        reads = partial(is_served, lambda: plc.read_holding_registers(0, 1))
        assert not reads()
        assert visitor.post("/fault", number=number, on=False) == {}
        visitor.receive(lambda: not visitor.rows("faults")[0]["is_on"])
        until(reads)
        visitor.post("/fault", number=number, on=True)
        until(lambda: not reads())


def test_a_fault_that_is_added_on_the_page_hits_requests() -> None:
    with page_of() as (server, url, visitor), visitor.watching():
        body = {"unit": 2, "kind": "no_answer", "function": 3, "every": None, "seconds": None}
        assert visitor.post("/faults", **body) == {}
        visitor.receive(lambda: visitor.seen["faults"])
        (state,) = server.fault_switch.states()
        assert (state.unit, state.fault) == (2, Fault("no_answer", function=3))
        with Client(url, unit=2, timeout=0.3) as plc, pytest.raises(ModbusTimeoutError):
            until(lambda: plc.read_holding_registers(0, 1) is None)


def test_a_page_shows_changes_that_other_code_makes() -> None:
    with page_of() as (server, _, visitor), visitor.watching():
        visitor.look(1, "holding_registers", 0, 8)
        visitor.receive(lambda: visitor.cells("1/holding_registers"))
        mapping = Mapping(holding_registers={0: [77] * 8})
        server.replace({1: Device(mapping)}, faults={1: [Fault("no_answer")]})
        visitor.receive(
            lambda: visitor.cells("1/holding_registers")[0] == 77 and visitor.seen["faults"]
        )
        assert [row["number"] for row in visitor.rows("units")] == [1]
        assert visitor.rows("units")[0]["tables"] == {"holding_registers": [[0, 8]]}
        server.replace({3: Device(mapping)})
        visitor.receive(lambda: list(visitor.seen["units"]) == ["3"])
        assert "1/holding_registers" not in visitor.seen
        visitor.look(3, "holding_registers", 0, 8)
        visitor.receive(lambda: visitor.cells("3/holding_registers"))


def test_the_number_of_faults_is_limited() -> None:
    faults = [Fault("delay", seconds=1.5), *[Fault("no_answer")] * 198]
    with page_of(faults={1: faults}) as (server, _, visitor), visitor.watching():
        assert visitor.rows("faults")[0]["settings"] == "seconds 1.5"
        number = max(map(int, visitor.seen["faults"]))  # equal ones are switched one by one
        assert visitor.post("/fault", number=number, on=False) == {}
        assert [state.is_on for state in server.fault_switch.states()] == [True] * 198 + [False]
        fault = {"unit": 2, "kind": "no_answer"}
        assert visitor.post("/faults", **fault) == {}
        assert "there are 200 faults already" in visitor.post("/faults", **fault)
