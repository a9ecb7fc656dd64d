"""What is installed beside the package: the manual page, and completion in shells."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from libmodbus_py.cli.commands import COMMANDS

ROOT = Path(__file__).parents[2]
BASH = ROOT / "packaging" / "shared" / "libmodbus-py"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("man") / "libmodbus-py.1"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "SOURCE_DATE_EPOCH": "1700000000"}
    subprocess.run(
        [sys.executable, ROOT / "packaging" / "man.py", path], env=environment, check=True
    )
    return path


def test_the_manual_page_has_the_help_of_every_command(page: Path) -> None:
    text = page.read_text()
    assert text.startswith('.TH LIBMODBUS-PY 1 "2023-11-14" "libmodbus-py ')
    for name in COMMANDS:
        assert f"\n.SH {name.upper()}\n.EX\nusage: libmodbus\\-py {name} " in text
    assert "\\-\\-watch" in text


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_finds_no_mistake_in_the_manual_page(page: Path) -> None:
    done = subprocess.run(
        ["man", "--warnings", "-l", str(page)],
        env=os.environ | {"MANWIDTH": "100", "LC_ALL": "C.UTF-8"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    for text in ("libmodbus-py read", "--watch", "libmodbus-py diagnose", "'"):
        assert text in done.stdout


@pytest.mark.parametrize(("typed", "found"), [("dia", ["diagnose"]), ("ga", ["gateway"])])
def test_the_installed_script_completes_in_bash(
    typed: str, found: list[str], tmp_path: Path
) -> None:
    pytest.importorskip("argcomplete")
    program = tmp_path / "libmodbus-py"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m libmodbus_py "$@"\n')
    program.chmod(0o755)
    line = f"libmodbus-py {typed}"
    script = f"source {BASH}; COMP_LINE='{line}'; COMP_POINT={len(line)}; COMP_TYPE=9;"
    script += "_libmodbus_py libmodbus-py; printf '%s\\n' \"${COMPREPLY[@]}\""
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "--norc", "-c", script], env=environment, capture_output=True, text=True
    )
    assert done.stderr == ""
    assert [each.strip() for each in done.stdout.splitlines()] == found
