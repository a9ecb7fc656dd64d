"""The tool that changes the package in single places finds what no test notices."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

TANK = """\
class Tank:
    level: int | None = None

    @property
    def is_full(self) -> bool | None:
        if self.level is None:
            raise ValueError("a tank of 10 + 1")
        return self.level > 9

    def empty(self) -> None:
        self.level = 0
"""
TESTS = """\
from libmodbus_py.tank import Tank


def test_a_tank_is_full() -> None:
    tank = Tank()
    tank.empty()
    assert not tank.is_full
    tank.level = 9
    assert not tank.is_full
    tank.level = 10
    assert tank.is_full


def test_fails_without_a_mutant() -> None:
    assert Tank().is_full
"""


@pytest.mark.slow
def test_a_change_without_a_failing_test_is_printed_as_a_diff(tmp_path: Path) -> None:
    """Of six places, two are drawn: the condition, which a test notices, and the 0."""
    pytest.importorskip("cosmic_ray", reason="./run mutants installs it")
    files = {"__init__.py": "", "tank.py": TANK, "../tests/tank/test_tank.py": TESTS}
    for name, text in files.items():
        path = tmp_path / "libmodbus_py" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    command = [sys.executable, "-m", "fuzz.mutants", "tank.py", "--tests", "tank", "--jobs", "1"]
    command += ["--sample", "2", "--seed", "2"]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    process = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=environment
    )
    assert "1 of 2 mutants were killed: 50.0%" in process.stdout
    assert "no failure of 1 tests:" in process.stdout
    assert "-        self.level = 0\n" in process.stdout
    assert (tmp_path / "libmodbus_py/tank.py").read_text() == TANK
