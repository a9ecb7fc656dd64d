"""Intervals of points, and points that devices refuse or are silent about, in simulated time."""

import asyncio
import logging
from pathlib import Path
from typing import Any, Literal

import pytest

from libmodbus_py import IllegalDataAddress, ModbusTimeoutError, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet.config import devices_from_json, devices_to_json
from libmodbus_py.services.fleet.files import FleetFileError, load
from libmodbus_py.services.fleet.poller import DeviceState, Poller
from tests.services.fleet.fleets import in_simulated_time
from tests.simulation.plants import Plant
from tests.support.cases import each_case

H: Literal["holding_registers"] = "holding_registers"

MAP = RegisterMap(
    [
        Point("v", H, 0),
        Point("energy", H, 10, interval=60, group="totals", never_falls=True),
        Point("serial", H, 20, interval=86_400, group="plate"),
        Point("model", H, 21, group="plate", interval=86_400),
    ]
)


def config(**options: Any) -> DeviceConfig:
    return DeviceConfig("m", "tcp://192.0.2.1", MAP, **{"interval": 10, **options})


class Polled:
    """A device that is polled each 10 seconds."""

    def __init__(self, **options: Any) -> None:
        device = config(**options)
        self.poller = Poller(device)
        self.cells = {0: 230, 10: 100, 20: 7, 21: 8}
        self.asked: list[int] = []
        self.now = 1000.0

    def poll(self, error: Exception | None = None, *, at: int | None = None) -> dict[str, Any]:
        self.asked = []
        self.poller.begin(self.now)
        while (request := self.poller.request) is not None:
            self.asked.append(request.address)
            failed = error if at in (None, request.address) else None
            cells = [self.cells[request.address + number] for number in range(request.count)]
            self.poller.take_outcome(failed or cells, self.now)
        self.now += self.poller.interval
        return {item.name: (item.value, item.reason) for item in self.poller.readings(self.now, 0)}


def test_points_are_asked_and_reported_at_their_intervals() -> None:
    device = Polled()
    assert set(device.poll()) == {"v", "energy", "serial", "model"}
    for _ in range(3):
        for _ in range(5):
            assert device.poll() == {"v": (230, "")}
            assert device.asked == [0]
        assert set(device.poll()) == {"v", "energy"}
    assert device.asked == [0, 10]


def test_no_point_is_read_before_its_interval() -> None:
    device = Polled(interval=25)
    assert ["energy" in device.poll() for _ in range(7)] == [True, False, False] * 2 + [True]


def test_the_shortest_interval_is_that_of_the_device() -> None:
    assert Polled(interval=300).poller.interval == 60
    assert Polled(interval=300, items=("v",)).poller.interval == 300
    assert Polled(items=("serial", "model")).poller.interval == 86_400


def test_all_due_points_of_a_restored_device_are_read() -> None:
    device = Polled()
    for _ in range(9):
        device.poll(ModbusTimeoutError("away"))
        assert device.asked == [0] or len(device.asked) == 1
    assert set(device.poll()) == {"v", "energy", "serial", "model"}
    assert device.poll() == {"v": (230, "")}


def test_an_error_of_a_point_and_its_end_are_logged_once() -> None:
    device = Polled()
    device.poll()
    for _ in range(5):
        device.poll()
    readings = device.poll(ModbusTimeoutError("lost"), at=10)
    assert readings == {"v": (230, ""), "energy": (None, "ModbusTimeoutError")}
    assert device.poll() == {"v": (230, ""), "energy": (100, "")}
    assert device.poll() == {"v": (230, "")}


def test_groups_are_read_beside_items() -> None:
    assert config(groups=("plate",)).names == ("serial", "model")
    assert config(items=("v", "model"), groups=("plate",)).names == ("v", "model", "serial")
    device = config(items=("v",), groups=("totals",), dead_bands={"energy": 1})
    assert devices_from_json(devices_to_json([device]))[0].names == ("v", "energy")


def test_fleet_files_select_groups(tmp_path: Path) -> None:
    (tmp_path / "map.csv").write_text(
        "name,table,address,group,interval\nv,holding,0,,\ne,holding,1,totals,60\n"
    )
    head = '[[device]]\nname = "m"\nurl = "tcp://192.0.2.1"\nmap = "map.csv"\n'
    rows = "name,url,map,groups\nm,tcp://192.0.2.1,map.csv,totals\n"
    (tmp_path / "devices.csv").write_text(rows)
    for text in (f'{head}groups = ["totals"]\n', 'devices = "devices.csv"\n'):
        (tmp_path / "fleet.toml").write_text(text)
        assert load(tmp_path / "fleet.toml").devices[0].names == ("e",)
    (tmp_path / "fleet.toml").write_text(f'{head}groups = ["total"]\n')
    reason = (
        r"line 5: device\[0\]\.groups\[0\]: the map has no group 'total' to read; it has totals"
    )
    with pytest.raises(FleetFileError, match=reason):
        load(tmp_path / "fleet.toml")


TWENTY = [Point(f"p{at}", H, at) for at in range(20)]
MANY = RegisterMap(TWENTY)


def plant_of() -> Plant:
    return Plant("tcp://10.0.0.1", "?timeout=1")


def device(plant: Plant, unit: int, points: RegisterMap = MANY) -> DeviceConfig:
    return plant.device(unit, points, interval=10.0)


def refused(plant: Plant) -> dict[str, list[str]]:
    """Return the names of the points that each device is known to refuse."""
    return {
        name: [name.name for name in poller.unreadable]
        for name, poller in plant.fleet.devices.items()
    }


@in_simulated_time
async def test_a_refused_address_costs_ten_requests_and_is_logged_once(caplog) -> None:
    caplog.set_level(logging.WARNING, "libmodbus_py")
    plant = plant_of()
    plant.missing[1] = {7}
    async with plant.polls(device(plant, 1)):
        counts = []
        for _ in range(10):
            await asyncio.sleep(10)
            counts.append(plant.taken())
        assert counts[0] <= 1 + 10
        assert counts[1:] == [2] * 9
        poller = plant.fleet.devices["device 1"]
        assert poller.state is DeviceState.UP
        assert refused(plant) == {"device 1": ["p7"]}
        assert isinstance(poller.error, IllegalDataAddress)
        plant.missing.clear()
        await asyncio.sleep(700)
        assert poller.unreadable == []
        assert poller.error is None
    qualities = [(item.quality, item.reason) for item in plant.readings if item.name == "p7"]
    assert qualities[0] == ("bad", "IllegalDataAddress")
    assert set(qualities[1:]) == {("good", "")}
    others = [reading for reading in plant.readings if reading.name != "p7"]
    assert all(other.quality == "good" and other.value == int(other.name[1:]) for other in others)
    assert caplog.messages == [
        "device 1: cannot be read: p7, holding_registers 7 (1 register): "
        "illegal data address (exception 2)"
    ]


@in_simulated_time
async def test_a_device_that_falls_silent_during_a_search_is_searched_later() -> None:
    plant = plant_of()
    plant.missing[1] = {7}
    async with plant.polls(device(plant, 1)):
        while len(plant.asked) < 3:
            await asyncio.sleep(0.001)
        plant.silent = {1}
        await asyncio.sleep(50)
        assert plant.fleet.devices["device 1"].state is DeviceState.DOWN
        assert refused(plant) == {"device 1": []}
        plant.silent = set()
        await asyncio.sleep(200)
        assert refused(plant) == {"device 1": ["p7"]}


@each_case("stop", range(1, 8))
@in_simulated_time
async def test_devices_replaced_during_a_search_keep_only_true_refusals(stop: int) -> None:
    """The search does not continue, and the refusals found so far are right."""
    plant = plant_of()
    plant.missing = {1: {7}, 2: {7}}
    one, two = device(plant, 1), device(plant, 2)
    async with plant.polls(one):
        while len(plant.asked) < stop:
            await asyncio.sleep(0.001)
        plant.fleet.replace([two])
        assert plant.taken(1) <= stop
        await asyncio.sleep(100)
        assert plant.taken(1) == 0
        plant.fleet.replace([one, two])
        await asyncio.sleep(100)
        assert [*refused(plant).values()] == [["p7"], ["p7"]]
