"""
Points of a fleet with intervals of their own, and groups of points.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import ModbusTimeoutError, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet.config import devices_from_json, devices_to_json
from libmodbus_py.services.fleet.files import FleetFileError, load
from libmodbus_py.services.fleet.poller import Poller, Reads
from libmodbus_py.services.fleet.trial import overloads

H = "holding_registers"

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
        self.poller = Poller(device, Reads(device))
        self.cells = {0: 230, 10: 100, 20: 7, 21: 8}
        self.asked: list[int] = []
        self.now = 1000.0

    def poll(self, error: Exception | None = None, *, at: int | None = None) -> dict[str, Any]:
        self.asked = []
        self.poller.begin(self.now)
        while (request := self.poller.request) is not None:
            self.asked.append(request.address)
            failed = error if at in (None, request.address) else None
            cells = [self.cells[request.address + each] for each in range(request.count)]
            self.poller.take(failed or cells, self.now)
        self.now += self.poller.interval
        return {each.name: (each.value, each.reason) for each in self.poller.readings(self.now)}


def test_points_are_asked_and_reported_at_their_intervals() -> None:
    device = Polled()
    assert set(device.poll()) == {"v", "energy", "serial", "model"}
    for _ in range(3):
        for _ in range(5):
            assert device.poll() == {"v": (230, "")}
            assert device.asked == [0]
        assert set(device.poll()) == {"v", "energy"}
    assert device.asked == [0, 10]


def test_no_point_is_asked_sooner_than_its_interval() -> None:
    device = Polled(interval=25)
    assert ["energy" in device.poll() for _ in range(7)] == [True, False, False] * 2 + [True]


def test_the_shortest_interval_is_that_of_the_device() -> None:
    assert Polled(interval=300).poller.interval == 60
    assert Polled(interval=300, items=("v",)).poller.interval == 300
    assert Polled(items=("serial", "model")).poller.interval == 86_400


def test_a_device_that_was_away_is_asked_for_all_that_is_due() -> None:
    device = Polled()
    for _ in range(9):
        device.poll(ModbusTimeoutError("away"))
        assert device.asked == [0] or len(device.asked) == 1
    assert set(device.poll()) == {"v", "energy", "serial", "model"}
    assert device.poll() == {"v": (230, "")}


def test_an_error_of_a_point_is_told_once_and_so_is_its_end() -> None:
    device = Polled()
    device.poll()
    for _ in range(5):
        device.poll()
    found = device.poll(ModbusTimeoutError("lost"), at=10)
    assert found == {"v": (230, ""), "energy": (None, "ModbusTimeoutError")}
    assert device.poll() == {"v": (230, ""), "energy": (100, "")}
    assert device.poll() == {"v": (230, "")}


def test_a_total_that_falls_is_read_again_at_the_next_poll() -> None:
    device = Polled()
    for _ in range(6):
        device.poll()
    device.cells[10] = 5
    assert device.poll() == {"v": (230, "")}
    assert device.asked == [0, 10]
    assert device.poll() == {"v": (230, ""), "energy": (5, "Fell")}
    assert device.poll() == {"v": (230, "")}


def test_groups_are_read_beside_items() -> None:
    assert config(groups=("plate",)).names == ("serial", "model")
    assert config(items=("v", "model"), groups=("plate",)).names == ("v", "model", "serial")
    device = config(items=("v",), groups=("totals",), dead_bands={"energy": 1})
    assert devices_from_json(devices_to_json([device]))[0].names == ("v", "energy")


def test_wrong_groups_are_named() -> None:
    for groups, message in (
        (["plates"], "groups.0: the map has no points of a group 'plates'; its groups are plate"),
        (["plate", "plate"], "'plate' is given twice"),
        ("plate", "groups must be a list of names, not str"),
    ):
        with pytest.raises((TypeError, ValueError)) as caught:
            config(groups=groups)
        assert message.split(":")[-1] in str(caught.value)


def test_fleet_files_select_groups(tmp_path: Path) -> None:
    (tmp_path / "map.csv").write_text(
        "name,table,address,group,interval\nv,holding,0,,\ne,holding,1,totals,60\n"
    )
    head = '[[device]]\nname = "m"\nurl = "tcp://192.0.2.1"\nmap = "map.csv"\n'
    (tmp_path / "fleet.toml").write_text(head + 'groups = ["totals"]\n')
    assert load(tmp_path / "fleet.toml").devices[0].names == ("e",)
    (tmp_path / "fleet.toml").write_text(head + 'groups = ["total"]\n')
    with pytest.raises(FleetFileError, match=r"fleet.toml, line 5: device\[0\]\.groups\[0\]"):
        load(tmp_path / "fleet.toml")
    rows = "name,url,map,groups\nm,tcp://192.0.2.1,map.csv,totals\n"
    (tmp_path / "devices.csv").write_text(rows)
    (tmp_path / "fleet.toml").write_text('devices = "devices.csv"\n')
    assert load(tmp_path / "fleet.toml").devices[0].names == ("e",)


def test_a_line_is_loaded_by_what_is_due() -> None:
    points = [Point(f"p{at}", H, 2 * at, interval=60) for at in range(50)]
    url = "rtu:///dev/ttyUSB0?baudrate=9600"
    slow = DeviceConfig("a", url, RegisterMap(points), interval=1)
    assert overloads([slow]) == []
    fast = DeviceConfig("a", url, RegisterMap([Point(f"p{at}", H, 2 * at) for at in range(50)]),
                        interval=1)  # fmt: skip
    assert len(overloads([fast])) == 1
