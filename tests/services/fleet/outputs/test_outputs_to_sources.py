"""
Outputs to the files that a fleet is read from: they would be the end of them.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py.services.fleet.files import FleetFileError, load
from tests.support.cases import each_case
from tests.support.commands import run

MAP = "name,table,address\nlevel,holding_registers,0\n"

FLEET = 'devices = "devices.csv"\n[[device]]\nname = "a"\nurl = "tcp://h"\nmap = "meter.csv"\n'

FILES = {
    "meter.csv": MAP,
    "devices.csv": "name,url,map\nb,tcp://h,other.csv\n",
    "other.csv": MAP,
    "secret": "secret\n",
}


def written(folder: Path, more: str = "") -> Path:
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "secret").chmod(0o600)
    (folder / "fleet.toml").write_text(FLEET + more)
    return folder / "fleet.toml"


SOURCES = ["fleet.toml", "./fleet.toml", "devices.csv", "meter.csv", "other.csv"]


@each_case("source", SOURCES)
@each_case("kind", ["json", "csv", "influx"])
def test_in_the_fleet_file(tmp_path: Path, kind: str, source: str) -> None:
    file = written(tmp_path, f'[output.{kind}]\npath = "{source}"\n')
    with pytest.raises(FleetFileError, match="which the fleet is read from"):
        load(file)


def test_a_file_with_a_password(tmp_path: Path) -> None:
    broker = '[output.mqtt]\nurl = "mqtt://h"\nuser = "u"\npassword_file = "secret"\n'
    file = written(tmp_path, f'{broker}[output.json]\npath = "secret"\n')
    with pytest.raises(FleetFileError, match="which the fleet is read from"):
        load(file)


@pytest.mark.parametrize("source", ["fleet.toml", "devices.csv", "link"])
def test_on_the_command_line(tmp_path: Path, source: str) -> None:
    file = written(tmp_path)
    (tmp_path / "link").symlink_to("meter.csv")
    done = run("poll", file, "--once", "--json", tmp_path / source)
    assert done.code == 2
    assert "which the fleet is read from" in done.err
    assert file.read_text() == FLEET
    assert (tmp_path / "meter.csv").read_text() == MAP
