"""Names of points on a device: values read and set by name, all of them or none."""

import threading
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Access, Device, Hook, Mapping, Point, RegisterMap
from tests.support.cases import each_case

MAP = RegisterMap(
    [
        Point("setpoint", "holding_registers", 0, scale=0.1, minimum=5, maximum=30),
        Point("energy", "holding_registers", 1, type="uint32", access="read"),
        Point("mode", "holding_registers", 3),
        Point("name", "holding_registers", 4, type="string:4"),
        Point("run", "coils", 7),
        Point("alarms", "discrete_inputs", 0, 3),
        Point("flow", "input_registers", 10, type="float32", minimum=0),
    ]
)


def test_values_are_set_and_read_by_point_names() -> None:
    device = Device.of_map(MAP, {"setpoint": 21.5, "name": "Ab", "alarms": [True, False, True]})
    assert device.mapping.holding_registers[0] == 215
    assert device["setpoint"] == 21.5
    assert device["alarms"] == [True, False, True]
    assert device["energy"] == 0
    device["energy"] = 0x12345
    assert device.mapping.holding_registers[1:3] == [1, 0x2345]
    device["flow"] = 1.5
    assert device.mapping.input_registers[10:12] == [0x3FC0, 0]
    device["run"] = True
    assert device["run"] is True
    assert device["name"].rstrip("\0") == "Ab"


def test_the_device_has_the_cells_of_its_points_and_no_others() -> None:
    mapping = Device.of_map(MAP).mapping
    assert mapping.holding_registers.ranges == (range(6),)
    assert mapping.coils.ranges == (range(7, 8),)
    assert mapping.discrete_inputs.ranges == (range(3),)
    assert mapping.input_registers.ranges == (range(10, 12),)


WRONG: list[tuple[dict[Any, Any], type[Exception], str]] = [
    ({"mode": 1, "setpont": 3}, KeyError, "no point 'setpont'; did you mean setpoint"),
    ({"mode": 1, 7: 3}, KeyError, "no point 7"),
    ({"mode": 1, "setpoint": 31}, ValueError, r"setpoint: value must be in 5\.\.30, not 31"),
    ({"mode": 1, "setpoint": 4.9}, ValueError, r"setpoint: value must be in 5\.\.30"),
    ({"mode": 1, "setpoint": "warm"}, TypeError, "setpoint: "),
    ({"mode": 65536}, ValueError, r"mode: .*0\.\.65535"),
    ({"mode": 1, "alarms": [True]}, ValueError, "alarms: .*list of 3"),
    ({"mode": 1, "flow": -0.5}, ValueError, "flow: "),
    ({"mode": 1, "flow": float("nan")}, ValueError, "flow: "),
]


@each_case(("values", "error", "message"), WRONG)
def test_an_update_with_a_wrong_value_changes_nothing(values, error, message) -> None:
    device = Device.of_map(MAP, {"setpoint": 20})
    with pytest.raises(error, match=message):
        device.update(values)
    assert (device["mode"], device["setpoint"], device["flow"]) == (0, 20, 0)
    with pytest.raises(error, match=message):
        Device.of_map(MAP, values)


def test_points_that_share_cells_cannot_be_set_at_once() -> None:
    both = RegisterMap([Point("a", "coils", 0, 2), Point("b", "coils", 1)])
    device = Device.of_map(both)
    with pytest.raises(ValueError, match="a and b share coils 1"):
        device.update({"b": True, "a": [True, True]})
    assert device["a"] == [False, False]
    device["b"] = True
    assert device["a"] == [False, True]


def test_points_beside_a_mapping_of_the_program() -> None:
    device = Device(
        Mapping(holding_registers=10, coils=8, discrete_inputs=3), points=RegisterMap(())
    )
    assert len(device.points) == 0
    with pytest.raises(KeyError, match="no point 'mode'"):
        device["mode"]
    few = RegisterMap([MAP["mode"], MAP["energy"]])
    device = Device(Mapping(holding_registers=10), points=few)
    assert device.points is few
    assert device.answer(b"\3\0\x06\0\1") == b"\3\2\0\0"  # a cell without a point
    with pytest.raises(
        ValueError, match=r"flow: <input_registers empty> lacks its cells, 10\.\.11"
    ):
        Device(Mapping(holding_registers=10), points=RegisterMap([MAP["flow"]]))
    with pytest.raises(ValueError, match=r"mode: .* lacks its cells, 3\.\.3"):
        Device(Mapping(holding_registers=2), points=few)


@each_case(
    "make",
    [
        lambda: Device.of_map({"mode": MAP["mode"]}),  # type: ignore[arg-type]
        lambda: Device(Mapping(coils=8), points=[MAP["run"]]),  # type: ignore[arg-type]
        lambda: Device.of_map(MAP, [("mode", 1)]),  # type: ignore[arg-type]
    ],
)
def test_invalid_maps_are_refused(make: Any) -> None:
    with pytest.raises(TypeError, match="must be"):
        make()


def test_hooks_get_names_and_old_values() -> None:
    log: list[tuple[str, Access]] = []
    device = Device.of_map(
        MAP,
        {"setpoint": 21.5, "mode": 3},
        before_write=lambda access: log.append(("before", access)),
        after_write=Hook(lambda access: log.append(("after", access)), holding_registers=range(9)),
        before_read=lambda access: log.append(("read", access)),
    )
    device["mode"] = 4  # no hook hears of it
    assert device.answer(b"\6\0\0\0\xc8") == b"\6\0\0\0\xc8"
    assert device.answer(b"\3\0\0\0\4")[:2] == b"\3\x08"
    accesses = [(kind, entry.names, entry.values, entry.old_values) for kind, entry in log]
    assert accesses == [
        ("before", ("setpoint",), (200,), (215,)),
        ("after", ("setpoint",), (200,), (215,)),
        ("read", ("setpoint", "energy", "mode"), (), ()),
    ]


def test_old_values_without_names() -> None:
    accesses: list[Access] = []
    device = Device(Mapping(coils=8), files={4: [7, 8, 9]}, after_write=accesses.append)
    device.answer(b"\x0f\0\1\0\3\1\5")
    device.answer(bytes.fromhex("15 0b 06 0004 0001 0002 0001 0002"))
    assert [(access.names, access.values, access.old_values) for access in accesses] == [
        ((), (True, False, True), (False, False, False)),
        ((), (1, 2), (8, 9)),
    ]


def test_other_threads_see_an_update_as_a_whole() -> None:
    two = RegisterMap([Point("a", "holding_registers", 0), Point("b", "holding_registers", 900)])
    device = Device.of_map(two)
    torn: list[tuple[int, int]] = []
    is_done = threading.Event()

    def look() -> None:
        while not is_done.is_set():
            with device.mapping:
                if device["a"] != device["b"]:
                    torn.append((device["a"], device["b"]))

    thread = threading.Thread(target=look)
    thread.start()
    for number in range(500):
        device.update({"a": number, "b": number})
    is_done.set()
    thread.join()
    assert torn == []


def test_a_device_is_made_from_the_path_of_a_map(tmp_path: Path) -> None:
    path = tmp_path / "boiler.csv"
    path.write_text("name,table,address,scale\nsetpoint,holding,3,0.1\n")
    for place in (path, str(path)):
        device = Device.of_map(place, {"setpoint": 21.5})
        assert device.mapping.holding_registers[3] == 215
        assert device.mapping.holding_registers.ranges == (range(3, 4),)
    path.write_text("name,table\n")
    with pytest.raises(ValueError, match=r"boiler.csv, line 1: "):
        Device.of_map(path)
    for wrong in (5, b"boiler.csv", None):
        with pytest.raises(TypeError, match="map must be a RegisterMap or the path of"):
            Device.of_map(wrong)  # type: ignore[arg-type]
