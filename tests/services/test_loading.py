"""Files of any kind are told apart by what they contain."""

from pathlib import Path

import pytest

from libmodbus_py import RegisterMap
from libmodbus_py.files.texts import FileError
from libmodbus_py.services.fleet.files import FleetFile
from libmodbus_py.services.gateway.config import GatewayFile
from libmodbus_py.services.loading import load
from libmodbus_py.tools.simulator.simulated import Simulation
from tests.support.cases import each_case

EXAMPLES = Path(__file__).parents[2] / "examples"


@each_case(
    ("name", "kind"),
    [
        ("meter.toml", Simulation),
        ("meter.csv", RegisterMap),
        ("plant.toml", Simulation),
        ("gateway.toml", GatewayFile),
        ("fleet.toml", FleetFile),
    ],
)
def test_contents_decide_the_kind_of_a_file(name: str, kind: type, monkeypatch: pytest.MonkeyPatch):
    for variable in ("MQTT_PASSWORD", "INFLUX_PASSWORD", "INFLUX_TOKEN"):
        monkeypatch.setenv(variable, "secret")
    assert isinstance(load(EXAMPLES / name), kind)


def test_a_map_in_toml_or_markdown_is_a_map(tmp_path: Path) -> None:
    toml, markdown = tmp_path / "map.toml", tmp_path / "map.md"
    toml.write_text('[[point]]\nname = "a"\ntable = "coils"\naddress = 1\n')
    markdown.write_text("| name | table | address |\n|---|---|---|\n| a | coils | 1 |\n")
    assert list(load(toml)) == list(load(markdown)) == ["a"]


@each_case(
    ("text", "message"),
    [
        ("", "{}: must have top-level keys of exactly one kind of file (point, unit, route, "),
        ("x = 1", "{}: must have top-level keys of exactly one kind of file ("),
        ("[[unit]]\n[[route]]", "{}: must have top-level keys of exactly one kind of file ("),
        ("[[unit]", "{}: Expected ']]'"),
        ("[[unit]]\nid = 300", "{}, line 2: unit[0].id must be in 0..255, not 300"),
        ("[[point]]\nname = 1", "{}, line 1: point[0].table is missing"),
        ("[[device]]\nname = 'a'", "{}, line 1: device[0].url is missing"),
        ("[[route]]\nurl = 1", "{}, line 2: route[0].url: url must be a string"),
    ],
)
def test_a_file_of_no_kind_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "file.toml"
    path.write_text(text)
    with pytest.raises(FileError) as raised:
        load(path)
    assert str(raised.value).startswith(message.format(path))


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"^cannot read .*none\.toml: No such file"):
        load(tmp_path / "none.toml")
