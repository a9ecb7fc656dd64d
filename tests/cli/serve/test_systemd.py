"""Commands under systemd, and in other locales and with other umasks."""

import configparser
import csv
import json
import os
import shlex
import shutil
import socket
import sqlite3
import stat
import subprocess
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from libmodbus_py import Client
from libmodbus_py.cli.commands import parse_arguments
from libmodbus_py.cli.serve.running import notify_ready
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.cli.serving import FLEET_OF_ONE
from tests.support.commands import PROGRAM, Started
from tests.support.programs import missing, program, run_to_end


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        yield manager


@pytest.mark.parametrize("name", ["serve", "gateway", "poll"])
def test_each_command_notifies_systemd(name, device: str, manager: socket.socket, tmp_path):
    (tmp_path / "fleet.toml").write_text(FLEET_OF_ONE.format(url=device))
    arguments = {
        "serve": ["tcp://127.0.0.1:0"],
        "gateway": ["tcp://127.0.0.1:0", "--to", device],
        "poll": ["fleet.toml", "--json", "readings.json"],
    }[name]
    environment = {"NOTIFY_SOCKET": manager.getsockname()}
    with Started(name, *arguments, environment=environment, folder=tmp_path) as process:
        assert manager.recv(100) == b"READY=1"
        process.terminate()
        process.wait()


def test_an_abstract_socket_is_notified_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("")  # Linux chooses an abstract name
        manager.settimeout(60)
        name = manager.getsockname()
        assert name[:1] == b"\0"
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name[1:].decode())
        notify_ready()
        assert manager.recv(100) == b"READY=1"


@pytest.mark.parametrize("place", ["", "relative", "/nowhere/notify", "@nobody", "/" + "x" * 200])
def test_a_missing_service_manager_changes_nothing(place, monkeypatch) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", place)
    before = os.listdir("/proc/self/fd")
    notify_ready()
    assert os.listdir("/proc/self/fd") == before


DEPLOY = Path(__file__).parents[3] / "deploy"

UNITS = sorted(DEPLOY.glob("*.service"))

# systemd calls everything above this at least medium.
MOST_EXPOSED = 2.5


def ids(path: Path) -> str:
    return path.stem


@pytest.mark.parametrize("unit", UNITS, ids=ids)
def test_each_command_in_a_unit_exists(unit: Path) -> None:
    read = configparser.ConfigParser(strict=False, interpolation=None)
    read.optionxform = str  # type: ignore[assignment, method-assign]
    read.read_string(unit.read_text())
    service = read["Service"]
    program, *arguments = shlex.split(service["ExecStart"])
    assert program.endswith("/libmodbus-py")
    name = unit.stem.removeprefix("libmodbus-py-")
    assert arguments[0] == {"worker": "poll"}.get(name, name)
    command = parse_arguments(arguments)
    assert command.run is not None
    assert getattr(command, "state", "${STATE_DIRECTORY}/state.json") == (
        "${STATE_DIRECTORY}/state.json"
    )
    assert (service["Type"], service["Restart"]) == ("notify", "always")
    assert service["ExecReload"] == "/bin/kill -HUP $MAINPID"


@pytest.mark.parametrize("unit", UNITS, ids=ids)
@pytest.mark.skipif(bool(missing("systemd-analyze")), reason="systemd is not installed")
def test_systemd_calls_a_unit_well_protected(unit: Path) -> None:
    analyze = program("systemd-analyze")
    threshold = f"--threshold={MOST_EXPOSED * 10:.0f}"
    result = run_to_end(analyze, "security", "--offline=yes", threshold, unit)
    assert result.returncode == 0, result.stdout[-200:] + result.stderr
    verified = run_to_end(analyze, "verify", unit)
    unknown = [line for line in verified.stderr.splitlines() if "Unknown" in line]
    assert unknown == []


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
    target = folder / "tr_TR.UTF-8"
    result = subprocess.run(["localedef", "-i", "tr_TR", "-f", "UTF-8", str(target)], check=False)
    if result.returncode or not target.exists():
        pytest.skip("this system lacks the sources of locales")
    return {"LOCPATH": str(folder), "LC_ALL": "tr_TR.UTF-8", "LANGUAGE": "tr"}


@pytest.mark.parametrize("locale", ["C", "Turkish"])
def test_outputs_have_the_same_bytes_in_every_locale(
    fleet: Path, tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, locale: str
) -> None:
    variables = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    if locale == "Turkish":
        variables = turkish(tmp_path_factory.mktemp("locales"))
    result = under("022", "poll", fleet, "--once", folder=tmp_path, **variables)
    assert (result.returncode, result.stderr) == (0, b"")
    with open(tmp_path / "readings.csv", encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    line = json.loads((tmp_path / "readings.jsonl").read_text(encoding="utf-8"))
    for text in (row, line):
        assert (text["device"], text["name"]) == (DEVICE, NAME)
    with closing(sqlite3.connect(tmp_path / "fleet.db")) as database:
        rows = database.execute("SELECT device, name, unit FROM reading").fetchall()
    assert rows == [(DEVICE, NAME, UNIT)]


@pytest.mark.parametrize("umask", ["000", "077"])
def test_a_journal_is_never_written_to_by_others(fleet: Path, tmp_path: Path, umask: str) -> None:
    for count in (1, 2):
        result = under(umask, "poll", fleet, "--once", folder=tmp_path)
        assert (result.returncode, result.stderr) == (0, b"")
        with closing(sqlite3.connect(tmp_path / "fleet.db")) as database:
            assert database.execute("SELECT count(*) FROM reading").fetchone() == (count,)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.glob("fleet.db*")}
    assert {"fleet.db", "fleet.db-lock"} <= modes.keys()
    assert {name for name, mode in modes.items() if mode & OTHERS_WRITE} == set()
    if umask == "077":
        assert set(modes.values()) == {0o600}


@pytest.mark.parametrize("umask", ["000", "077"])
def test_only_the_owner_can_read_a_state_file(tmp_path: Path, umask: str) -> None:
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
        modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
        assert set(modes.values()) == {0o600}, modes
