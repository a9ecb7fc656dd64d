"""
Programs in C that talk through libmodbus, compiled once for all tests.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

SOURCES = Path(__file__).parent / "c"


def compile_c(source: Path, program: Path) -> Path:
    if shutil.which("gcc") is None:
        pytest.fail("no gcc: apt install gcc libmodbus-dev")
    done = subprocess.run(
        ["gcc", "-Wall", "-I/usr/include/modbus", source, "-o", program, "-lmodbus", "-pthread"],
        capture_output=True,
        text=True,
    )
    if done.returncode:
        pytest.fail(f"{source.name} (apt install libmodbus-dev): {done.stderr}")
    return program
