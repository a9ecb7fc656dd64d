"""Register maps by the paths of their files: wherever a map is taken, a path is, too."""

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, MapError, Server, load_map
from libmodbus_py.bound import BoundMap
from tests.support.cases import each_case

METER = """name,table,address,scale,access
voltage,input,0,0.1,
setpoint,holding,0,0.1,read_write
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "meter.csv"
    file.write_text(METER)
    return file


@pytest.mark.parametrize("kind", [str, Path])
def test_clients_take_the_path_of_a_map(path: Path, kind: Any) -> None:
    meter = kind(path)
    device = Device.of_map(load_map(path), {"voltage": 230.5})
    with Server(device).background("tcp://127.0.0.1:0") as running, Client(running.urls[0]) as plc:
        plc.write_map(meter, {"setpoint": 21.5})
        assert plc.read_map(meter) == {"voltage": 230.5, "setpoint": 21.5}
        assert next(plc.watch(meter, every=1, names=["voltage"])) == {"voltage": 230.5}
        assert plc.unreadable(meter) == []
        bound = BoundMap(plc, meter)
        bound.read("setpoint")
        assert bound.setpoint == 21.5


CALLS: list[Any] = [
    lambda plc, map: plc.read_map(map),
    lambda plc, map: plc.write_map(map, {}),
    lambda plc, map: plc.watch(map, every=1),
    lambda plc, map: plc.unreadable(map),
    lambda plc, map: BoundMap(plc, map),
]


@each_case("call", CALLS)
def test_paths_of_wrong_maps_are_refused_with_the_reason(path: Path, call: Any) -> None:
    path.write_text("name,table,address\nvoltage,inputt,0\n")
    plc = Client("tcp://127.0.0.1:1")
    for argument, message in (
        (path, f"{path}, line 2, column table: table must be one of"),
        (path.with_name("none.csv"), f"cannot read {path.with_name('none.csv')}"),
        (path.with_suffix(".xls"), "a register map must end with one of .toml"),
    ):
        with pytest.raises(MapError) as caught:
            call(plc, argument)
        assert message in str(caught.value)
    for wrong in (7, b"meter.csv"):
        with pytest.raises(TypeError, match="must be a"):
            call(plc, wrong)
    plc.close()
