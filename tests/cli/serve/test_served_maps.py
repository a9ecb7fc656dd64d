"""
serve --map: the points of a register map, with names, access and bounds, and no device file.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import Context, IllegalDataAddress, IllegalDataValue, load_map
from tests.cli.serving import serving
from tests.support.commands import run

AT = ["tcp://127.0.0.1:0"]

MAP = """\
name,table,address,type,scale,access,minimum,maximum
setpoint,holding,0,int16,0.1,read_write,-5,30
power,holding,1,uint32,,read,,
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "heat.csv").write_text(MAP)
    return tmp_path / "heat.csv"


def test_the_map_is_enforced(path: Path) -> None:
    heat = load_map(path)
    with serving(*AT, options=["--map", str(path)]) as (url,), Context.from_url(url, unit=9) as plc:
        plc.write_map(heat, {"setpoint": 21.5})
        with pytest.raises(IllegalDataValue):
            plc.write_register(0, 301)
        for forbidden in (
            lambda: plc.write_register(1, 5),
            lambda: plc.read_holding_registers(3, 1),
        ):
            with pytest.raises(IllegalDataAddress):
                forbidden()
        assert plc.read_map(heat) == {"setpoint": 21.5, "power": 0}


def test_a_map_of_the_package_is_served_by_its_name_to_some_units() -> None:
    with serving(*AT, options=["--map", "sdm120", "-u", "1,17"]) as (url,):
        found = run("read", url, "--map", "sdm120", "-u", "17", "voltage")
        assert (found.code, found.err) == (0, "")
        assert "voltage" in found.out
        assert run("read", url, "--map", "sdm120", "-u", "3", "voltage").code == 1


def test_columns_of_the_map_are_named(path: Path) -> None:
    path.write_text(MAP.replace("name,", "Bezeichnung,", 1))
    with serving(*AT, options=["--map", str(path), "--column", "name=Bezeichnung"]) as (url,):
        found = run("read", url, "--map", path, "--column", "name=Bezeichnung", "power")
        assert found.out == "power  0\n"
