"""
A meter and its map, for the tests of the commands that ask.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server

METER = """\
name,table,address,count,type,scale,unit,access,minimum,maximum
voltage,input_registers,0,1,uint16,0.1,V,read,,
phases,input_registers,10,3,int16,1,A,read,,
label,holding_registers,20,1,string:4,,,read_write,,
setpoint,holding_registers,30,1,int16,0.1,C,read_write,0,90
pump,coils,3,1,,,,read_write,,
"""


@pytest.fixture
def mapping() -> Mapping:
    mapping = Mapping(coils=100, discrete_inputs=16, holding_registers=600, input_registers=20)
    mapping.holding_registers[0:4] = [1, 2, 3, 0xFFFC]
    mapping.holding_registers[500:503] = [500, 501, 502]
    mapping.holding_registers[20:22] = [0x6162, 0x6364]
    mapping.input_registers[0] = 2305
    mapping.input_registers[10:13] = [1, 2, 0xFFFF]
    mapping.coils[5] = True
    return mapping


@pytest.fixture
def url(mapping: Mapping) -> Iterator[str]:
    device = Device(mapping, files={4: [7, 8, 9] + [0] * 400}, fifos={40: [5, 6]})
    with Server({1: device}).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@pytest.fixture
def meter(tmp_path: Path) -> str:
    path = tmp_path / "meter.csv"
    path.write_text(METER)
    return str(path)
