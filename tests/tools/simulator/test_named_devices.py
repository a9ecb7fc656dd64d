"""Device files with names, scales, defaults and maps: what clients, programs and pages see."""

import re
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, device_file, load_map, pdu
from libmodbus_py.device_file import SimulatedDevice, Simulation, load, parse
from libmodbus_py.fleet import load as load_fleet
from libmodbus_py.tools.page.server_source import set_point
from libmodbus_py.tools.page.units import ShownUnit, point_rows
from libmodbus_py.tools.simulator import example_files
from tests.tools.simulator.simulated_units import Clock, answer, holding, inputs

METER = """name,table,address,type,scale,unit,access
voltage,input,0,uint16,0.1,V,read
power,input,2,int32,,W,read
setpoint,holding,0,int16,0.5,°C,read_write
status,holding,5,uint16,,,read
status high,holding,5,bits16,,,read_write
name,holding,10,string:4,,,read_write
door,discrete,3,,,,read
pump,coil,4,,,,read_write
"""

Write = Callable[..., SimulatedDevice]


def the(simulation: Simulation) -> SimulatedDevice:
    assert isinstance(simulation.devices, SimulatedDevice)
    return simulation.devices


@pytest.fixture
def make_device(tmp_path: Path) -> Write:
    """Returns the device of a file that stands beside a map."""

    def make(text: str, map: str = METER, **options: Any) -> SimulatedDevice:
        (tmp_path / "map.csv").write_text(map)
        (tmp_path / "device.toml").write_text(f"[[unit]]\nmap = ['map.csv']\n{text}")
        return the(load(tmp_path / "device.toml", **options))

    return make


def test_a_device_has_its_names_and_points() -> None:
    devices = parse("""
        [[unit]]
        id = 1
        name = "Boiler"
        description = "in the cellar"
        holding_registers = [
            { address = 7, name = "flow", units = "°C", scale = 0.1, values = [55.5, 45] },
            { address = 100, type = "float32", order = "CDAB", access = "read" },
        ]
        discrete_inputs = [{ address = 3, count = 4 }]
        input_registers = [{ address = 0, counter = {} }]
        [[unit]]
        id = 2
    """).devices
    assert isinstance(devices, dict)
    boiler, other = devices[1], devices[2]
    assert (boiler.name, boiler.description) == ("Boiler", "in the cellar")
    assert (other.name, other.description, len(other.points)) == ("", "", 0)
    assert set(boiler.points) == {
        *("flow", "holding_registers_100", "discrete_inputs_3", "input_registers_0")
    }
    flow, ticks = boiler.points["flow"], boiler.points["input_registers_0"]
    assert (flow.units, flow.scale, flow.count) == ("°C", 0.1, 2)
    assert flow.decode(holding(boiler, 7, 2)) == [55.5, 45]
    float_ = boiler.points["holding_registers_100"]
    assert (float_.type, float_.order, float_.access, ticks.access) == (
        *("float32", "CDAB", "read", "read"),
    )


def test_defaults_apply_where_the_file_has_no_value() -> None:
    devices = parse("""
        [defaults]
        type = "uint32"
        access = "read"
        [[unit]]
        id = 1
        coils = [{ address = 0 }]
        holding_registers = [{ address = 0, value = 1 }, { address = 10, type = "uint16", access = "read_write" }]
        input_registers = [{ address = 0, counter = { start = 2 } }]
        [unit.defaults]
        order = "CDAB"
        [[unit]]
        id = 2
        holding_registers = [{ address = 0, value = 1 }]
    """).devices  # noqa: E501
    assert isinstance(devices, dict)
    assert (holding(devices[1], 0, 2), holding(devices[2], 0, 2)) == ([1, 0], [0, 1])
    assert inputs(devices[1], 0, 2)[1] == 0
    for request in (pdu.WriteRegister(0, 5), pdu.WriteCoil(0, True)):
        with pytest.raises(IllegalDataAddress):
            answer(devices[1], request)
    answer(devices[1], pdu.WriteRegister(10, 5))
    assert devices[1].points["holding_registers_0"].order == "CDAB"


RANGES = """
[[unit]]
holding_registers = [
    { address = 0, name = "remote", bit = 3, value = true },
    { address = 0, name = "mode", bit = "4..7", maximum = 9, value = 5 },
    { address = 1, name = "state", states = { 0 = "off", 1 = "on" }, value = "on" },
    { address = 2, name = "power", type = "int16", scale_from = "power_sf", value = 1250 },
    { address = 3, name = "power_sf", type = "int16", value = 1 },
    { address = 4, name = "clock", type = "date48", time_zone = "Europe/Berlin", value = 2024-07-15T10:00:00Z },
    { address = 7, name = "faults", bits = { 0 = "door", "4..7" = "code" }, value = { door = true, code = 3 } },
]
"""  # noqa: E501


def test_ranges_contain_encoded_values() -> None:
    device = the(parse(RANGES))
    assert list(device.mapping.holding_registers[0:8]) == [
        5 << 4 | 1 << 3, 1, 125, 1, 24 << 8 | 7, 15 << 8 | 12, 0, 0x31,
    ]  # fmt: skip
    assert {name: device[name] for name in device.points} == {
        "remote": True,
        "mode": 5,
        "state": "on",
        "power": 1250,
        "power_sf": 1,
        "clock": datetime(2024, 7, 15, 10, tzinfo=UTC),
        "faults": {"door": True, "code": 3},
    }
    device.update({"mode": 9})
    assert (device["remote"], device["mode"]) == (True, 9)
    with pytest.raises(ValueError, match=r"mode: value must be in \.\.9, not 10"):
        device["mode"] = 10


def test_all_points_of_a_map_exist(make_device: Write) -> None:
    device = make_device("")
    assert inputs(device, 0) == [0]
    assert inputs(device, 2, 2) == [0, 0]
    assert holding(device, 10, 2) == [0, 0]
    assert answer(device, pdu.ReadDiscreteInputs(3, 1)) == [False]
    for request in (
        pdu.ReadInputRegisters(1, 1),
        pdu.ReadCoils(3, 1),
        pdu.ReadInputRegisters(2, 3),
    ):
        with pytest.raises(IllegalDataAddress):
            answer(device, request)
    answer(device, pdu.WriteRegister(0, 41))
    assert device.points["setpoint"].decode(holding(device, 0)) == 20.5
    answer(device, pdu.WriteRegister(5, 1))  # one of its two points may be written
    assert list(device.points) == re.findall(r"^([\w ]+),", METER, re.MULTILINE)[1:]


def test_values_are_set_and_moved_by_name(make_device: Write) -> None:
    clock = Clock()
    text = """
        [unit.values]
        power = -966
        setpoint = 21.5
        "status high" = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1]
        name = "pump"
        pump = true
        [unit.moves]
        voltage = { sine = { low = 225, high = 235, period = 4 } }
        door = { counter = {} }
        [[unit.holding_registers]]
        address = 99
    """
    device = make_device(text, clock=clock)
    assert inputs(device, 0) == [2300]
    clock.now += 1
    assert inputs(device, 0) == [2350]
    assert answer(device, pdu.ReadDiscreteInputs(3, 1)) == [True]
    assert inputs(device, 2, 2) == [0xFFFF, 0x10000 - 966]
    assert (holding(device, 0), holding(device, 5)) == ([43], [0x8001])
    assert bytes(b for r in holding(device, 10, 2) for b in divmod(r, 256)) == b"pump"
    assert answer(device, pdu.ReadCoils(4, 1)) == [True]
    assert "holding_registers_99" in device.points


BOUNDS = """name,table,address,type,scale,access,minimum,maximum
setpoint,holding,0,uint16,0.1,read_write,5,30
total,holding,1,uint32,1,read_write,,70000
total_low,holding,2,uint16,1,read_write,,
power,input,0,int16,1,read,,
"""

MOVING = """
holding_registers = [{ address = 20, maximum = 100, name = "own" }, { address = 21, counter = {}, name = "ticks" }]
values = { setpoint = 20 }
moves = { power = { counter = { start = 5 } } }
"""  # noqa: E501


def test_bounds_apply_to_all_points_that_share_cells(make_device: Write) -> None:
    device = make_device(MOVING, BOUNDS)
    for request, code in (
        (pdu.WriteRegister(0, 49), 3),
        (pdu.WriteRegister(0, 50), 0),
        (pdu.WriteRegister(20, 101), 3),
        (pdu.WriteRegister(20, 100), 0),
        (pdu.WriteRegister(21, 0), 2),
        (pdu.WriteRegister(1, 1), 0),
        (pdu.WriteRegister(2, 4465), 3),
        (pdu.WriteRegister(2, 4464), 0),
    ):
        response = device.answer(request.encode())
        assert (response[1] if response[0] & 0x80 else 0) == code
    assert (device["setpoint"], device["own"]) == (5, 100)
    assert (device["total"], device["total_low"]) == (70_000, 4464)


def test_a_moving_value_cannot_be_written_by_another_name(make_device: Write) -> None:
    device = make_device("moves = { total = { counter = {} } }", BOUNDS)
    for address in (1, 2):
        with pytest.raises(IllegalDataAddress):
            answer(device, pdu.WriteRegister(address, 1))
    with pytest.raises(ValueError, match="total_low: the device computes this value itself"):
        device["total_low"] = 1


def test_named_values_move_by_themselves(make_device: Write) -> None:
    clock = Clock()
    device = make_device(MOVING, BOUNDS, clock=clock)
    clock.now += 7
    assert (device["power"], device["ticks"]) == (12, 7)
    for name in ("power", "ticks"):
        with pytest.raises(ValueError, match=f"{name}: the device computes this value itself"):
            device.update({"setpoint": 30, name: 3})
    assert device["setpoint"] == 20
    device.update({"setpoint": 30, "own": 3})
    assert (device["setpoint"], device["own"]) == (30, 3)
    with pytest.raises(KeyError, match="no point 'setpiont'; did you mean setpoint"):
        device["setpiont"] = 3


MEANINGS = """name,table,address,type,scale from,states,bit,bits,missing
v,holding,0,int16,v_sf,,,,
v_sf,holding,1,int16,,,,,
state,holding,2,,,0 = off; 1 = on,,,
flag,holding,3,,,,3,,
mode,holding,3,,,,4..7,,
flags,holding,4,,,,,0 = door; 1 = alarm,
level,holding,5,,,,,,0
"""


def test_a_page_shows_and_sets_decoded_values(make_device: Write) -> None:
    values = "v = 230.5, v_sf = -1, state = 'on', flag = true, mode = 5, flags = { alarm = true }"
    device = make_device(f"values = {{ {values} }}", MEANINGS)
    assert device.mapping.holding_registers[0:6] == [2305, 0xFFFF, 1, 0x58, 2, 0]
    points = device.points
    unit = ShownUnit(None, device)

    def texts() -> list[str]:
        return [row["text"] for row in point_rows(unit, 0, 100).values()]

    assert texts() == ["230.5", "-1", "on", "on", "5", "door=0 alarm=1", "- (Missing)"]
    for name, text in (("mode", "2"), ("state", "off"), ("flags", "door=1"), ("v_sf", "0")):
        set_point(unit, points[name], text)
    assert texts() == ["2305", "0", "off", "on", "2", "door=1 alarm=1", "- (Missing)"]
    assert device.mapping.holding_registers[3] == 0x28
    with pytest.raises(ValueError, match="value must be one of off, on, or a number, not 'up'"):
        set_point(unit, points["state"], "up")


def test_examples_are_described_and_can_be_loaded() -> None:
    files = example_files.descriptions()
    beside = {path.stem for path in Path(__file__).parents[3].glob("examples/*.toml")}
    assert beside - {"fleet", "gateway"} == set(files)
    for name, description in files.items():
        assert 10 < len(description) < 100
        load(example_files.path_of(name))
    with pytest.raises(ValueError, match=r"no example 'plants'; there are .*meter, .*plant"):
        example_files.path_of("plants")


FLEET = '[[device]]\nname = "a"\nurl = "tcp://127.0.0.1"\nmap = "{name}"\n'

FORMS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "fleet file": (FLEET, lambda path: load_fleet(path).devices[0].map),
    "device file": (
        '[[unit]]\nid = 1\nmap = "{name}"\n',
        lambda path: device_file.load(path).devices[1].points,
    ),
    "list of devices": ('devices = "list.csv"\n', lambda path: load_fleet(path).devices[0].map),
}


@pytest.mark.parametrize("form", FORMS)
def test_maps_of_the_package_have_names_and_other_maps_endings(form, tmp_path) -> None:
    (tmp_path / "sdm120.csv").write_text("name,table,address\nown,holding_registers,7\n")

    def names(map: str) -> set[str]:
        text, read = FORMS[form]
        (tmp_path / "file.toml").write_text(text.replace("{name}", map))
        (tmp_path / "list.csv").write_text(f"name,url,map\na,tcp://127.0.0.1,{map}\n")
        return set(read(tmp_path / "file.toml"))

    assert names("sdm120") == set(load_map(example_files.map_file("sdm120")))
    assert names("sdm120.csv") == {"own"}
    message = r"'sdm12' is neither the path of a register map.* the examples are abb_b23, .*sdm120"
    with pytest.raises(ValueError, match=rf"{re.escape(str(tmp_path))}.*map: {message}"):
        names("sdm12")
