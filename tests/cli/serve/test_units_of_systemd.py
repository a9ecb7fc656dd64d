"""
The units in deploy/: systemd understands them, and what they start does.
"""

from __future__ import annotations

import configparser
import shlex
import subprocess
from pathlib import Path

import pytest

from libmodbus_py.cli.commands import parsed
from tests.support.programs import missing, program

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
    done = subprocess.run(
        [analyze, "security", "--offline=yes", f"--threshold={MOST_EXPOSED * 10:.0f}", unit],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stdout[-200:] + done.stderr
    verified = subprocess.run(
        [analyze, "verify", unit], capture_output=True, text=True, check=False, timeout=60
    )
    unknown = [line for line in verified.stderr.splitlines() if "Unknown" in line]
    assert unknown == []
