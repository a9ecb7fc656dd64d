"""
The maps of real devices, on simulated ones: every value against what the registers on the wire
hold, decoded here with `struct` by what the manuals say.
"""

from __future__ import annotations

import struct
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, RegisterMap, Server, device_file, load_map
from tests.support.clients import Connect

EXAMPLES = Path(__file__).parents[2] / "examples"

# Function, address, struct's form of the bytes, divisor, and what the device shows.
Reading = tuple[int, int, str, str, Any]

SDM630: dict[str, Reading] = {
    "voltage_l1": (4, 0x00, ">f", "1", 230.25),
    "voltage_l3": (4, 0x04, ">f", "1", 229.75),
    "current_l2": (4, 0x08, ">f", "1", 0.25),
    "power_l2": (4, 0x0E, ">f", "1", -57.875),
    "power": (4, 0x34, ">f", "1", 3735.25),
    "power_factor": (4, 0x3E, ">f", "1", 0.96875),
    "frequency": (4, 0x46, ">f", "1", 50.0),
    "import_energy": (4, 0x48, ">f", "1", 12345.75),
    "export_energy": (4, 0x4A, ">f", "1", 678.5),
    "total_energy": (4, 0x156, ">f", "1", 13024.25),
    "import_energy_l3": (4, 0x15E, ">f", "1", 5000.0),
    "demand_period": (3, 2, ">f", "1", 60.0),
}

# The manual's numbers of registers, less 1.
IEM3155: dict[str, Reading] = {
    "model": (3, 50 - 1, "40s", "", "iEM3155"),
    "manufacturer": (3, 70 - 1, "40s", "", "Schneider Electric"),
    "serial_number": (3, 130 - 1, ">I", "1", 2024031234),
    "current_l1": (3, 3000 - 1, ">f", "1", 10.5),
    "voltage_l1_l2": (3, 3020 - 1, ">f", "1", 400.5),
    "voltage_l1": (3, 3028 - 1, ">f", "1", 231.25),
    "power_l3": (3, 3058 - 1, ">f", "1", -1.875),
    "power": (3, 3060 - 1, ">f", "1", 2.625),
    "frequency": (3, 3110 - 1, ">f", "1", 50.03125),
    "import_energy": (3, 3204 - 1, ">q", "1000", 98765432.109),
    "export_energy": (3, 3208 - 1, ">q", "1000", 0.001),
    "import_energy_l3": (3, 3526 - 1, ">q", "1000", 34382715.555),
}

VICTRON: dict[str, Reading] = {
    "serial": (3, 800, "12s", "", "c0619ab12345"),
    "relay_1": (3, 806, ">H", "1", 1),
    "consumption_l2": (3, 818, ">H", "1", 1033),
    "grid_l1": (3, 820, ">h", "1", -1520),
    "battery_voltage": (3, 840, ">H", "10", 52.3),
    "battery_current": (3, 841, ">h", "10", -12.7),
    "battery_power": (3, 842, ">h", "1", -664),
    "consumed_charge": (3, 845, ">H", "-10", -30.5),
    "time_to_go": (3, 846, ">H", "0.01", 18000),
    "solar_current": (3, 851, ">h", "10", 56.4),
    "grid_setpoint": (3, 2700, ">h", "1", -50),
    "minimum_charge": (3, 2901, ">H", "10", 20.5),
}

DEVICES = {"sdm630": (1, SDM630), "iem3155": (1, IEM3155), "victron_gx": (100, VICTRON)}


@contextmanager
def served(connect: Connect, name: str) -> Iterator[tuple[Any, RegisterMap]]:
    simulation = device_file.load(EXAMPLES / f"{name}.toml")
    with (
        Server(*simulation).background("tcp://127.0.0.1:0") as running,
        connect(running.urls[0], unit=DEVICES[name][0], timeout=5) as plc,
    ):
        yield plc, load_map(EXAMPLES / f"{name}.csv")


def on_the_wire(plc: Any, function: int, address: int, form: str, divisor: str) -> Any:
    read: Callable[[int, int], list[int]] = (
        plc.read_holding_registers if function == 3 else plc.read_input_registers
    )
    registers = read(address, struct.calcsize(form) // 2)
    (raw,) = struct.unpack(form, struct.pack(f">{len(registers)}H", *registers))
    if isinstance(raw, bytes):
        return raw.rstrip(b"\0").decode()
    scaled = Fraction(raw) / Fraction(divisor)
    return scaled.numerator / scaled.denominator


@pytest.mark.parametrize("name", DEVICES)
def test_each_value_is_what_the_manual_says(connect: Connect, name: str) -> None:
    with served(connect, name) as (plc, points):
        values = plc.read_map(points)
        for point, (*place, shown) in DEVICES[name][1].items():
            assert values[point] == shown, point
            assert on_the_wire(plc, *place) == shown, point
        # And all others are those of the device file.
        said = tomllib.loads((EXAMPLES / f"{name}.toml").read_text())["unit"][0]["values"]
        assert {key: value for key, value in values.items() if key in said} == said
        assert {value for key, value in values.items() if key not in said} <= {0}


def test_a_meter_takes_a_period(connect: Connect) -> None:
    with served(connect, "sdm630") as (plc, points):
        plc.write_map(points, {"demand_period": 15})
        assert plc.read_holding_registers(2, 2) == [0x4170, 0]
        with pytest.raises(ValueError, match=r"^demand_period: value must be in 0..60, not 61$"):
            plc.write_map(points, {"demand_period": 61})
        # Its manual: at most 80 registers in a request.
        assert plc.read_map(points, max_registers=80)["demand_period"] == 15
        with pytest.raises(IllegalDataAddress):
            plc.read_input_registers(0, 20)


def test_a_house_takes_a_setpoint(connect: Connect) -> None:
    with served(connect, "victron_gx") as (plc, points):
        plc.write_map(points, {"grid_setpoint": -1500, "minimum_charge": 35.5, "relay_2": 1})
        assert plc.read_holding_registers(2700, 1) == [0x10000 - 1500]
        assert plc.read_holding_registers(2901, 1) == [355]
        assert plc.read_holding_registers(806, 2) == [1, 1]
        with pytest.raises(ValueError, match=r"^battery_voltage cannot be written: "):
            plc.write_map(points, {"relay_1": 0, "battery_voltage": 50})
        assert plc.read_map(points, ["relay_1"]) == {"relay_1": 1}
