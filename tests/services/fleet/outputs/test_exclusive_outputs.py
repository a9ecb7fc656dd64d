"""Outputs that would write to one place, or to a file the fleet is read from; several of a kind."""

import os
from pathlib import Path

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Journal
from libmodbus_py.services.fleet.files import FleetFileError, load
from libmodbus_py.services.fleet.outputs.line_file import CsvOutput, JsonOutput
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.golden import Refused
from tests.support.outputs import FakeOutput

SERVER = '[[output.influx]]\nurl = "http://h:8086"\n'

BROKER = '[[output.mqtt]]\nurl = "mqtt://h"\n'

COMMANDED = f'{BROKER}commands = true\nstatus = ""\n'


METER_MAP = "name,table,address\nlevel,holding_registers,0\n"

FLEET = 'devices = "devices.csv"\n[[device]]\nname = "a"\nurl = "tcp://h"\nmap = "meter.csv"\n'

FILES = {
    "meter.csv": METER_MAP,
    "devices.csv": "name,url,map\nb,tcp://h,other.csv\n",
    "other.csv": METER_MAP,
    "secret": "secret\n",
}


def fleet_file(folder: Path, outputs: str = "") -> Path:
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "secret").chmod(0o600)
    (folder / "fleet.toml").write_text(FLEET + outputs)
    return folder / "fleet.toml"


def test_a_fleet_file_may_have_several_outputs_of_each_kind(tmp_path: Path) -> None:
    file = load(
        fleet_file(
            tmp_path,
            '[[output.csv]]\npath = "a.csv"\n[[output.csv]]\npath = "b.csv"\n'
            '[[output.json]]\npath = "a.jsonl"\n[[output.json]]\npath = "-"\n'
            f'{BROKER}topic = "x/{{device}}/{{name}}"\n{BROKER}topic = "y/{{device}}/{{name}}"\n'
            '[[output.mqtt]]\nurl = "mqtt://other"\n'
            f'{BROKER}topic = "x/{{name}}/{{device}}"\n'
            f'{COMMANDED}topic = "z/{{device}}/{{name}}"\n'
            f'{COMMANDED}topic = "y/{{name}}/{{device}}/z"\n'
            f'{SERVER}database = "a"\n{SERVER}database = "b"\n'
            f'{SERVER}database = "a"\nmeasurement = "raw"\n[[output.influx]]\npath = "a.lines"\n'
            f'{SERVER}bucket = "c"\ntoken_file = "secret"\n',
        )
    )
    assert len(Fleet(file.devices, outputs=file.make_outputs())._receivers.outputs) == 15


def test_a_fleet_file_with_two_outputs_to_one_file_is_refused(tmp_path: Path, refused: Refused):
    def load_outputs(outputs: str) -> None:
        try:
            load(fleet_file(tmp_path, outputs.replace("FOLDER", tmp_path.name)))
        except FleetFileError as error:
            raise ValueError(str(error).replace(os.path.realpath(tmp_path), "FILE")) from None

    refused("one_place.txt", load_outputs)


def test_a_link_and_its_target_are_the_same_file(tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(tmp_path / "a")
    outputs = [JsonOutput(str(tmp_path / "a")), CsvOutput(str(tmp_path / "link"))]
    with pytest.raises(ValueError, match=r"^two outputs use the file .*/a$"):
        Fleet([], outputs=outputs)


@each_case(
    ("one", "other"),
    [
        (lambda: JsonOutput(), lambda: CsvOutput()),
        (lambda: Mqtt("mqtt://h"), lambda: Mqtt("mqtt://h:1883", user="x")),
    ],
)
def test_a_program_with_two_outputs_to_one_file_is_refused(one, other) -> None:
    with pytest.raises(ValueError, match=r"^two outputs use "):
        Fleet([], outputs=[one(), other()])


def test_one_output_given_twice_is_refused() -> None:
    output = FakeOutput()
    with pytest.raises(ValueError, match="two outputs use the same fake"):
        Fleet([], outputs=[output, output])


def test_a_path_with_a_zero_byte_is_refused() -> None:
    with pytest.raises(ValueError, match="path must not contain the character 0"):
        JsonOutput("a\0b")


@each_case("name", ["fleet.db", "fleet.db-wal", "link"])
def test_an_output_cannot_write_into_a_file_of_the_journal(name: str, tmp_path: Path) -> None:
    """SQLite would find lines of text in its file, and the output what SQLite writes."""
    (tmp_path / "link").unlink(missing_ok=True)
    (tmp_path / "link").symlink_to("fleet.db")
    journal = Journal(tmp_path / "fleet.db")
    with pytest.raises(ValueError, match=r"the journal and csv .* use the file .*fleet\.db"):
        Fleet(outputs=[CsvOutput(str(tmp_path / name))], journal=journal)
    Fleet(outputs=[CsvOutput(str(tmp_path / "other"))], journal=journal)


SOURCES = ["fleet.toml", "./fleet.toml", "devices.csv", "meter.csv", "other.csv", "secret"]


@each_case("source", SOURCES)
@each_case("kind", ["json", "csv", "influx"])
def test_a_fleet_file_output_overwrites_no_source(tmp_path: Path, kind: str, source: str) -> None:
    broker = f'{BROKER}user = "u"\npassword_file = "secret"\n'
    file = fleet_file(tmp_path, f'{broker}[output.{kind}]\npath = "{source}"\n')
    with pytest.raises(FleetFileError, match="which the fleet is read from"):
        load(file)


@pytest.mark.parametrize("source", ["devices.csv", "link"])
def test_an_output_of_the_command_line_cannot_overwrite_a_source(tmp_path: Path, source: str):
    file = fleet_file(tmp_path)
    (tmp_path / "link").symlink_to("meter.csv")
    result = run("poll", file, "--once", "--json", tmp_path / source)
    assert result.code == 2
    assert "which the fleet is read from" in result.err
    assert file.read_text() == FLEET
    assert (tmp_path / "meter.csv").read_text() == METER_MAP
