"""
systemd is told once a command serves, and understands the units in deploy/, which start commands.
"""

import configparser
import os
import shlex
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.cli.commands import parsed
from libmodbus_py.cli.serve.running import notify_ready
from tests.cli.serving import FLEET_OF_ONE
from tests.support.commands import Started
from tests.support.programs import missing, program, run_to_end


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        yield manager


@pytest.mark.parametrize("name", ["serve", "gateway", "poll"])
def test_each_command_tells_that_it_serves(
    name: str, device: str, manager: socket.socket, tmp_path: Path
) -> None:
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


def test_an_abstract_socket_is_told_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("")  # Linux chooses an abstract name
        manager.settimeout(60)
        name = manager.getsockname()
        assert name[:1] == b"\0"
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name[1:].decode())
        notify_ready()
        assert manager.recv(100) == b"READY=1"


@pytest.mark.parametrize("place", ["", "relative", "/nowhere/notify", "@nobody", "/" + "x" * 200])
def test_a_manager_that_is_not_there_changes_nothing(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", place)
    before = os.listdir("/proc/self/fd")
    notify_ready()
    assert os.listdir("/proc/self/fd") == before


# --- units in deploy/ ------------------------------------------------------------------

DEPLOY = Path(__file__).parents[3] / "deploy"

UNITS = sorted(DEPLOY.glob("*.service"))

# systemd calls everything above this at least medium.
MOST_EXPOSED = 2.5


def ids(path: Path) -> str:
    return path.stem


@pytest.mark.parametrize("unit", UNITS, ids=ids)
def test_the_command_of_a_unit_is_one_of_ours(unit: Path) -> None:
    read = configparser.ConfigParser(strict=False, interpolation=None)
    read.optionxform = str  # type: ignore[assignment, method-assign]
    read.read_string(unit.read_text())
    service = read["Service"]
    program, *arguments = shlex.split(service["ExecStart"])
    assert program.endswith("/libmodbus-py")
    name = unit.stem.removeprefix("libmodbus-py-")
    assert arguments[0] == {"worker": "poll"}.get(name, name)
    command = parsed(arguments)
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
    done = run_to_end(analyze, "security", "--offline=yes", threshold, unit)
    assert done.returncode == 0, done.stdout[-200:] + done.stderr
    verified = run_to_end(analyze, "verify", unit)
    unknown = [line for line in verified.stderr.splitlines() if "Unknown" in line]
    assert unknown == []
