"""
Device files with names, scales, defaults and register maps: what clients and programs find.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from libmodbus_py import Context, IllegalDataAddress, Server, load_map, pdu
from libmodbus_py.tools.simulator import example_files
from libmodbus_py.tools.simulator.device_file import (
    DeviceFileError,
    SimulatedDevice,
    Simulation,
    load,
    parse,
)
from tests.support.cases import each_case
from tests.tools.simulator.simulated_units import Clock, answer, holding, inputs

MAP = """name,table,address,type,scale,unit,access
voltage,input,0,uint16,0.1,V,read
power,input,2,int32,,W,read
setpoint,holding,0,int16,0.5,°C,read_write
status,holding,5,uint16,,,read
status high,holding,5,bits16,,,read_write
name,holding,10,string:4,,,read_write
door,discrete,3,,,,read
pump,coil,4,,,,read_write
"""


def the(simulation: Simulation) -> SimulatedDevice:
    assert isinstance(simulation.devices, SimulatedDevice)
    return simulation.devices


@pytest.fixture
def written(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a device file beside the map."""
    (tmp_path / "meter.csv").write_text(MAP)

    def write(text: str) -> Path:
        path = tmp_path / "device.toml"
        path.write_text(text)
        return path

    return write


# --- scales ----------------------------------------------------------------------------------

REGISTER = "[[unit]]\n[[unit.input_registers]]\naddress = 0\n"


@each_case(
    ("content", "registers"),
    [
        ("scale = 0.1\nvalue = 230.5", [2305]),
        ("scale = 0.1\nvalues = [230.5, 0.04, 0.06]", [2305, 0, 1]),
        ("scale = 0.1\noffset = -20\nvalue = -20", [0]),
        ("scale = 10\nvalue = 655350", [65535]),
        ("scale = -1\nvalue = -7", [7]),
        ("offset = 100", [0]),
        ("type = 'int32'\nscale = 0.001\nvalue = -0.001", [0xFFFF, 0xFFFF]),
        ("type = 'float32'\nscale = 0.5\nvalue = 0.5", [0x3F80, 0]),
        ("scale = 1\nunits = 'V'\nvalue = 3", [3]),
    ],
)
def test_values_are_those_that_users_see(content: str, registers: list[int]) -> None:
    assert inputs(the(parse(REGISTER + content)), 0, len(registers)) == registers


def test_what_moves_is_scaled() -> None:
    clock = Clock()
    device = the(
        parse(
            """
            [[unit]]
            [[unit.input_registers]]
            address = 0
            scale = 0.1
            sine = { low = 220, high = 240, period = 4 }
            [[unit.input_registers]]
            address = 1
            scale = 0.5
            counter = { start = 1.5, step = 0.5, interval = 1 }
            [[unit.input_registers]]
            address = 2
            scale = 0.1
            counter = { start = 6553.5, step = 0.1, interval = 1 }
            [[unit.input_registers]]
            address = 3
            scale = 0.01
            copy = { table = "input_registers", address = 0, scale = 0.5 }
            """,
            clock=clock,
        )
    )
    assert inputs(device, 0, 4) == [2300, 3, 65535, 11500]
    clock.now += 1
    assert inputs(device, 0, 4) == [2400, 4, 65535, 12000]
    clock.now += 2
    assert inputs(device, 0, 2) == [2200, 6]


# --- names -----------------------------------------------------------------------------------


def test_a_device_knows_its_names_and_points() -> None:
    simulation = parse("""
        [[unit]]
        id = 1
        name = "Boiler"
        description = "in the cellar"
        [[unit.holding_registers]]
        address = 7
        name = "flow"
        description = "of the heating"
        units = "°C"
        scale = 0.1
        values = [55.5, 45]
        [[unit.holding_registers]]
        address = 100
        type = "float32"
        order = "CDAB"
        access = "read"
        [[unit.discrete_inputs]]
        address = 3
        count = 4
        [[unit.input_registers]]
        address = 0
        counter = {}
        [[unit]]
        id = 2
    """)
    assert isinstance(simulation.devices, dict)
    boiler, other = simulation.devices[1], simulation.devices[2]
    assert (boiler.name, boiler.description) == ("Boiler", "in the cellar")
    assert (other.name, other.description, len(other.points)) == ("", "", 0)
    assert set(boiler.points) == {
        *("flow", "holding_registers_100", "discrete_inputs_3", "input_registers_0")
    }
    flow = boiler.points["flow"]
    assert (flow.units, flow.scale, flow.count, flow.description) == (
        "°C",
        0.1,
        2,
        "of the heating",
    )
    assert flow.decode(holding(boiler, 7, 2)) == [55.5, 45]
    other_point = boiler.points["holding_registers_100"]
    assert (other_point.type, other_point.order, other_point.access) == ("float32", "CDAB", "read")
    assert boiler.points["discrete_inputs_3"].count == 4
    assert boiler.points["input_registers_0"].access == "read"


def test_a_range_may_have_the_name_that_another_would_get() -> None:
    text = "[[unit.coils]]\naddress = 0\n[[unit.coils]]\naddress = 5\nname = 'coils_0'\n"
    points = the(parse("[[unit]]\n" + text)).points
    assert {name: point.address for name, point in points.items()} == {"coils_0": 5, "coils_0_": 0}


def test_two_ranges_of_one_name_are_a_mistake() -> None:
    text = "[[unit.coils]]\naddress = 0\nname = 'a'\n[[unit.coils]]\naddress = 5\nname = 'a'\n"
    with pytest.raises(DeviceFileError, match=r"coils\[1\].name: there is already a point a"):
        parse("[[unit]]\n" + text)


# --- defaults --------------------------------------------------------------------------------


def test_defaults_hold_where_nothing_else_is_said() -> None:
    simulation = parse("""
        [defaults]
        type = "uint32"
        access = "read"
        [[unit]]
        id = 1
        [unit.defaults]
        order = "CDAB"
        [[unit.holding_registers]]
        address = 0
        value = 1
        [[unit.holding_registers]]
        address = 10
        type = "uint16"
        access = "read_write"
        [[unit.input_registers]]
        address = 0
        counter = { start = 2 }
        [[unit.coils]]
        address = 0
        [[unit]]
        id = 2
        [[unit.holding_registers]]
        address = 0
        value = 1
    """)
    assert isinstance(simulation.devices, dict)
    one, two = simulation.devices[1], simulation.devices[2]
    assert holding(one, 0, 2) == [1, 0]
    assert holding(two, 0, 2) == [0, 1]
    assert inputs(one, 0, 2)[1] == 0
    for request in (pdu.WriteRegister(0, 5), pdu.WriteCoil(0, True)):
        with pytest.raises(IllegalDataAddress):
            answer(one, request)
    answer(one, pdu.WriteRegister(10, 5))
    assert one.points["holding_registers_0"].order == "CDAB"


# --- register maps ---------------------------------------------------------------------------


def test_all_points_of_a_map_exist(written: Callable[[str], Path]) -> None:
    device = the(load(written("[[unit]]\nmap = 'meter.csv'\n")))
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
    assert list(device.points) == re.findall(r"^([\w ]+),", MAP, re.MULTILINE)[1:]


def test_values_and_moves_by_name(written: Callable[[str], Path]) -> None:
    path = written("""
        [[unit]]
        map = ["meter.csv"]
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
    """)
    clock = Clock()
    device = the(load(path, clock=clock))
    assert inputs(device, 0) == [2300]
    clock.now += 1
    assert inputs(device, 0) == [2350]
    assert answer(device, pdu.ReadDiscreteInputs(3, 1)) == [True]
    assert inputs(device, 2, 2) == [0xFFFF, 0x10000 - 966]
    assert holding(device, 0) == [43]
    assert holding(device, 5) == [0x8001]
    assert bytes(b for r in holding(device, 10, 2) for b in divmod(r, 256)) == b"pump"
    assert answer(device, pdu.ReadCoils(4, 1)) == [True]
    assert "holding_registers_99" in device.points


def test_a_client_reads_the_example_by_its_map() -> None:
    path = example_files.path_of("meter")
    simulation = load(path)
    assert not any(simulation.faults.values())  # the first device of a new user
    with (
        Server(*simulation).background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0], unit=1) as client,
    ):
        found = client.read_map(the(simulation).points)
        assert found["power"] == 966
        assert found["current"] == 4.2
        assert found["frequency"] == 50.02
        assert found["label"] == "cellar"
        assert found["temperature"] == 21.5
        assert 225 <= found["voltage"] <= 235.5
        client.write_map(the(simulation).points, {"alarm_limit": 250.5})
        assert client.read_holding_registers(0, 1) == [2505]
        assert client.read_map(load_map(example_files.map_file("meter")))["alarm_limit"] == 250.5


def test_examples_are_described_and_can_be_loaded() -> None:
    found = example_files.described()
    beside = {path.stem for path in Path(__file__).parents[3].glob("examples/*.toml")}
    assert beside - {"fleet", "gateway"} == set(found)
    for name, description in found.items():
        assert 10 < len(description) < 100
        load(example_files.path_of(name))
    with pytest.raises(ValueError, match=r"no example 'plants'; there are .*meter, .*plant"):
        example_files.path_of("plants")
