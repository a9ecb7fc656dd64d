"""Programs in C that talk through libmodbus, compiled once for all tests."""

import shutil
import subprocess
from pathlib import Path

import pytest

SOURCES = Path(__file__).parent / "c"


def compile_c(source: Path, program: Path, *options: str) -> Path:
    """Compile a source; options are gcc's, such as -shared for a library."""
    if shutil.which("gcc") is None:
        pytest.fail("no gcc: apt install gcc libmodbus-dev")
    command = ["gcc", "-Wall", "-I/usr/include/modbus", *options, source, "-o", program]
    result = subprocess.run([*command, "-lmodbus", "-pthread"], capture_output=True, text=True)
    if result.returncode:
        pytest.fail(f"{source.name} (apt install libmodbus-dev): {result.stderr}")
    return program
