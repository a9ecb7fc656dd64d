"""
A moving value of a simulator that is held on its page: it stays, can be set, and goes on.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.page import live_page
from libmodbus_py.tools.page.units import CanHold
from libmodbus_py.tools.simulator.clockwork import Clockwork
from libmodbus_py.tools.simulator.device_file import load
from libmodbus_py.tools.simulator.simulated import SimulatedDevice
from tests.tools.page.watching import Visitor

PLANT = """
[[unit]]
id = 1
[[unit.holding_registers]]
address = 0
name = "level"
counter = { start = 10, step = 1, interval = 0.05 }
[[unit.holding_registers]]
address = 1
name = "fixed"
value = 7
"""


@pytest.fixture
def visitor(tmp_path: Path) -> Iterator[Visitor]:
    (tmp_path / "plant.toml").write_text(PLANT)
    simulation = load(tmp_path / "plant.toml")
    with live_page(Server(simulation.devices)) as page, Visitor(page.url).watching() as visitor:
        visitor.look(1, "points", 0, 9)
        yield visitor


def test_a_held_value_stays_can_be_set_and_goes_on(visitor: Visitor) -> None:
    level = {"unit": 1, "point": 0, "name": "level"}

    def row() -> tuple[str, bool | None, list[int]]:
        text, moves, spark = visitor.seen.get("1/points", {"0": ["", None, []]})["0"]
        return text, moves, spark

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


def test_what_never_moves_cannot_be_held(visitor: Visitor) -> None:
    fixed = {"unit": 1, "point": 1, "name": "fixed", "on": True}
    assert visitor.post("/hold", **fixed) == "fixed: never moves by itself"
    assert visitor.post("/hold", **{**fixed, "name": "level"}) == "this point no longer exists"
    assert visitor.post("/hold", **{**fixed, "unit": 9}) == "there is no unit 9"
    assert "point must be" in visitor.post("/hold", **{**fixed, "point": 2})
    assert not isinstance(Device(Mapping()), CanHold)


def device_of(file: Path) -> SimulatedDevice:
    devices = load(file).devices
    return devices if isinstance(devices, SimulatedDevice) else devices[1]


def test_a_held_value_is_held_after_its_file_was_read_again(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(PLANT)
    before = device_of(file)
    before.hold(before.points["level"], is_on=True)
    before["level"] = 33
    file.write_text(PLANT.replace("value = 7", "value = 8"))
    after = device_of(file)
    after.go_on_from(before)
    assert (after["level"], after.movement(after.points["level"])) == (33, False)
    after.hold(after.points["level"], is_on=False)
    assert after["level"] != 33
    assert Clockwork(after.mapping, []).holds("coils", range(9)) is False
