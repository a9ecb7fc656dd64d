"""
The units of a device file and their faults.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import Context, ExceptionResponse, Server
from libmodbus_py.tools.faults.fault import Fault
from libmodbus_py.tools.simulator.device_file import load, parse
from tests.tools.simulator.simulated_units import HOLDING


def test_units_are_told_apart_and_faults_are_collected() -> None:
    devices, faults = parse("""
        [[fault]]
        kind = "no_answer"
        every = 9
        [[unit]]
        id = 247
        exception_status = 1
        [[unit.fault]]
        kind = "delay"
        seconds = 2
        [[unit]]
        id = 0
        exception_status = 2
    """)
    assert isinstance(devices, dict)
    assert {number: device.exception_status for number, device in devices.items()} == {247: 1, 0: 2}
    assert faults == {None: [Fault("no_answer", every=9)], 247: [Fault("delay", seconds=2)]}


def test_the_faults_of_a_unit_without_id_are_for_every_unit() -> None:
    _, faults = parse("""
        [[unit]]
        [[unit.fault]]
        kind = "no_answer"
        [[fault]]
        kind = "wrong_unit"
    """)
    assert faults == {None: [Fault("wrong_unit"), Fault("no_answer")]}


def test_every_unit_of_a_file_without_id_is_served(tmp_path: Path) -> None:
    path = tmp_path / "device.toml"
    path.write_text(HOLDING + "value = 42\n[[unit.fault]]\nkind='exception'\ncode=3\nfunction=1\n")
    with Server(*load(path)).background("tcp://127.0.0.1:0") as running:
        for number in (0, 1, 255):
            with Context.from_url(running.urls[0], unit=number) as client:
                assert client.read_holding_registers(0, 1) == [42]
                with pytest.raises(ExceptionResponse, match="exception 3"):
                    client.read_coils(0, 1)
