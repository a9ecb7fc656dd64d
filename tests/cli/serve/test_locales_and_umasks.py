"""
Commands in other locales and with other umasks: files have the same bytes everywhere, and no file
of values can be written to by others.
"""

import csv
import json
import os
import shutil
import sqlite3
import stat
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from libmodbus_py import Client
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.commands import PROGRAM

# Dotted and dotless letters, which are each other's capitals in Turkish only.
NAME, UNIT, DEVICE = "\u0131s\u0131-\u0130I", "°C", "KIŞLIK"

FLEET = """
journal = "fleet.db"
[[device]]
name = "{device}"
url = "{url}"
[[device.point]]
name = "{name}"
table = "holding_registers"
address = 0
type = "int16"
units = "{unit}"
[output.csv]
path = "readings.csv"
[output.json]
path = "readings.jsonl"
"""

OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Path]:
    with ServerMaker() as maker:
        path = tmp_path / "fleet.toml"
        text = FLEET.format(url=maker().url, name=NAME, unit=UNIT, device=DEVICE)
        path.write_text(text, encoding="utf-8")
        yield path


def under(
    umask: str, *arguments: object, folder: Path, **variables: str
) -> subprocess.CompletedProcess[bytes]:
    """Run a command to its end, with a umask and variables."""
    return subprocess.run(
        ["sh", "-c", f'umask {umask}; exec "$@"', "sh", *PROGRAM, *map(str, arguments)],
        cwd=folder,
        env=os.environ | variables,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        timeout=60,
    )


def turkish(folder: Path) -> dict[str, str]:
    """Make the locale, which few systems have installed."""
    if shutil.which("localedef") is None:
        pytest.skip("localedef is not installed")
    made = folder / "tr_TR.UTF-8"
    done = subprocess.run(["localedef", "-i", "tr_TR", "-f", "UTF-8", str(made)], check=False)
    if done.returncode or not made.exists():
        pytest.skip("this system lacks the sources of locales")
    return {"LOCPATH": str(folder), "LC_ALL": "tr_TR.UTF-8", "LANGUAGE": "tr"}


@pytest.mark.parametrize("locale", ["C", "Turkish"])
def test_outputs_have_the_same_bytes_in_every_locale(
    fleet: Path, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, locale: str
) -> None:
    variables = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    if locale == "Turkish":
        variables = turkish(tmp_path_factory.mktemp("locales"))
    done = under("022", "poll", fleet, "--once", folder=tmp_path, **variables)
    assert (done.returncode, done.stderr) == (0, b"")
    with open(tmp_path / "readings.csv", encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    line = json.loads((tmp_path / "readings.jsonl").read_text(encoding="utf-8"))
    for found in (row, line):
        assert (found["device"], found["name"]) == (DEVICE, NAME)
    with closing(sqlite3.connect(tmp_path / "fleet.db")) as database:
        kept = database.execute("SELECT device, name, unit FROM reading").fetchall()
    assert kept == [(DEVICE, NAME, UNIT)]


@pytest.mark.parametrize("umask", ["000", "077"])
def test_a_journal_is_never_written_to_by_others(fleet: Path, tmp_path: Path, umask: str) -> None:
    for count in (1, 2):
        done = under(umask, "poll", fleet, "--once", folder=tmp_path)
        assert (done.returncode, done.stderr) == (0, b"")
        with closing(sqlite3.connect(tmp_path / "fleet.db")) as database:
            assert database.execute("SELECT count(*) FROM reading").fetchone() == (count,)
    modes = {each.name: each.stat().st_mode & 0o777 for each in tmp_path.glob("fleet.db*")}
    assert {"fleet.db", "fleet.db-lock"} <= modes.keys()
    assert {name for name, mode in modes.items() if mode & OTHERS_WRITE} == set()
    if umask == "077":
        assert set(modes.values()) == {0o600}


@pytest.mark.parametrize("umask", ["000", "077"])
def test_a_state_is_of_its_owner_alone(tmp_path: Path, umask: str) -> None:
    state = tmp_path / "state"
    for value in (7, 8):
        command = ["serve", "tcp://127.0.0.1:0", "--state", str(state)]
        with subprocess.Popen(
            ["sh", "-c", f'umask {umask}; exec "$@"', "sh", *PROGRAM, *command],
            stdout=subprocess.PIPE,
            text=True,
        ) as process:
            assert process.stdout is not None
            url = process.stdout.readline().removeprefix("listening on ").rstrip("\n")
            with Client(url) as plc:
                assert plc.read_holding_registers(0, 1) == [0 if value == 7 else 7]
                plc.write_register(0, value)
            process.terminate()
        modes = {each.name: each.stat().st_mode & 0o777 for each in tmp_path.iterdir()}
        assert set(modes.values()) == {0o600}, modes
