"""
What is typed wrong, and what cannot be reached: one line on stderr names it. Nothing is printed,
made or written, and nothing is sent for wrong usage (exit code 2).

`h` is no host; FOLDER has a map, a wrong one, a fleet file, two files of the user and what is
no capture.
"""

import re
import shlex
from pathlib import Path

import pytest

from tests.cli.serving import FLEET_OF_ONE
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.golden import Refused
from tests.support.names import resolve

FILES = {
    "meter.csv": "name,table,address,group\nlevel,holding,0,fast\n",
    "wrong.csv": "name,table,address\na,holding,70000\n",
    "fleet.toml": FLEET_OF_ONE.format(url="tcp://127.0.0.1:1"),
    "there.csv": "mine",
    "mine.py": "x = 1\n",
    "x.pcapng": "no capture",
}


DECODED = Path(__file__).parents[1] / "tools" / "listener" / "decoded.pcapng"

UNREACHABLE = [
    ("read 127.0.0.1:1 hr 0", "cannot connect to 127.0.0.1:1"),
    ("read plc.example:1 hr 0", "cannot connect to plc.example:1"),
    ("read no-such-host.invalid hr 0", "no-such-host"),
    ("read [::1]:1 hr 0", "cannot connect to [::1]:1"),
    ("read 127.0.0.1:1?unit=9 hr 0", "unit 9: cannot connect"),
    ("read 127.0.0.1:1?unit=9 hr 0 -u 8", "unit 8: cannot connect"),
    ("read /dev/no-such hr 0 -b 9600 -p none -s 2", "cannot open /dev/no-such"),
    ("read ./no-such hr 0", "no-such: No such file"),
    ("read 127.0.0.1:1 hr 0 --json /nowhere/x", "/nowhere/x: No such file or directory"),
    ("read 127.0.0.1:1 hr 0 --json=/nowhere/x", "/nowhere/x: No such file or directory"),
    ("ttyUSB99 hr 0", "/dev/ttyUSB99"),
    ("read ttyUSB99?baudrate=9600 hr 0", "/dev/ttyUSB99"),
    ("identify ttyACM99", "/dev/ttyACM99"),
    ("identify 127.0.0.1:1 -u 1-9", "cannot connect to 127.0.0.1:1"),
    ("diagnose 127.0.0.1:1 -u 1-9", "cannot connect to 127.0.0.1:1"),
    ("map from-device 127.0.0.1:1 -o FOLDER/found.csv", "cannot connect to 127.0.0.1:1"),
    ("serve ttyS99", "/dev/ttyS99"),
    ("serve rtu:///dev/null", "not a serial port"),
    ("gateway ttyUSB99 --to 127.0.0.1:1", "/dev/ttyUSB99"),
    ("listen ttyUSB99", "cannot open /dev/ttyUSB99: No such file or directory"),
    ("listen nowhere.pcapng", "nowhere.pcapng: No such file or directory"),
    (f"listen {DECODED} --capture /dev/full", "/dev/full: No space left on device"),
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    resolve(monkeypatch, "plc.example")
    for name, content in FILES.items():
        (tmp_path / name).write_text(content)
    return tmp_path


def error_of(folder: Path, line: str, code: int) -> str:
    """Run a command that fails, and return the one line that it prints."""
    result = run(*shlex.split(line.replace("FOLDER", str(folder))))
    assert (result.code, result.out) == (code, ""), result.err
    assert result.err.startswith("libmodbus-py: ")
    assert result.err.count("\n") == 1
    assert not re.search("sesame|token=", result.err)
    assert {path.name: path.read_text() for path in folder.iterdir()} == FILES
    text = result.err.removeprefix("libmodbus-py: ").rstrip("\n").replace(str(folder), "FOLDER")
    return re.sub(r"\S+/examples/", "EXAMPLES/", text)


def test_one_line_names_a_wrong_argument(folder: Path, refused: Refused) -> None:
    def raise_error(line: str) -> None:
        raise ValueError(error_of(folder, line, 2))

    refused("wrong_usage.txt", raise_error)


@each_case(("line", "message"), UNREACHABLE)
def test_one_line_names_an_unreachable_endpoint(folder: Path, line: str, message: str) -> None:
    assert message in error_of(folder, line, 1)
