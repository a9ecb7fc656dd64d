"""
Completion in real shells, and the manual page.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from libmodbus_py.cli.ask.items import TABLE_WORDS
from libmodbus_py.cli.ask.read import names as names_of_map
from tests.support.commands import run

argcomplete = pytest.importorskip("argcomplete")

MAP = "name,table,address\nvoltage,input,0\ncurrent,input,1\n"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder whose `bin` has the command."""
    command = tmp_path / "bin" / "libmodbus-py"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m libmodbus_py "$@"\n')
    command.chmod(0o755)
    (tmp_path / "meter.csv").write_text(MAP)
    return tmp_path


def shell(place: Path, command: list[str]) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PATH": f"{place / 'bin'}:{os.environ['PATH']}"}
    return subprocess.run(
        command, cwd=place, env=environment, capture_output=True, text=True, timeout=60
    )


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("libmodbus-py ident", {"identify"}),
        ("libmodbus-py read --wat", {"--watch"}),
        ("libmodbus-py read 127.0.0.1 hol", {"holding"}),
        ("libmodbus-py read --map meter.csv 127.0.0.1 vol", {"voltage"}),
        ("libmodbus-py completion ", {"bash", "zsh", "fish"}),
        ("libmodbus-py read --map met", {"meter", "meter.csv"}),
        ("libmodbus-py read 127.0.0.1 curr", set()),
        ("libmodbus-py read --map=meter.csv 127.0.0.1 hr 0 curr", {"current"}),
        ("libmodbus-py read 127.0.0.1 hr 0 --type floa", {"float16", "float32", "float64"}),
        ("libmodbus-py write 127.0.0.1 hr 0 1 --order AB", {"ABCD"}),
        ("libmodbus-py read /dev/ttyUSB0 -p e", {"even"}),
        ("libmodbus-py serve --example pla", {"plant"}),
    ],
)
def test_bash(place: Path, line: str, found: set[str]) -> None:
    words = " ".join(f"'{word}'" for word in line.split(" "))
    script = (
        'eval "$(libmodbus-py completion bash)"\n'
        f"COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}; COMP_WORDS=({words})\n"
        "COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 )); COMP_TYPE=9\n"
        "_python_argcomplete libmodbus-py\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    done = shell(place, ["bash", "-c", script])
    assert done.stderr == ""
    assert {each.strip() for each in done.stdout.split()} - {"--help"} == found


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish(place: Path) -> None:
    script = "libmodbus-py completion fish | source; complete -C 'libmodbus-py dia'"
    done = shell(place, ["fish", "--no-config", "-c", script])
    assert [line.partition("\t")[0] for line in done.stdout.splitlines()] == ["diagnose"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_zsh_takes_the_script(place: Path) -> None:
    script = 'autoload -U compinit; compinit -D; eval "$(libmodbus-py completion zsh)"'
    script += "; echo $_comps[libmodbus-py]"
    done = shell(place, ["zsh", "-f", "-c", script])
    assert done.stdout.strip().startswith("_python_argcomplete")


def test_without_argcomplete_it_says_what_to_install() -> None:
    program = (
        "import sys; sys.modules['argcomplete'] = None\n"
        "from libmodbus_py.cli.main import main; sys.exit(main(['completion', 'bash']))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == (
        "libmodbus-py: completion needs argcomplete: pip install 'libmodbus-py[completion]'\n"
    )


def test_shells_nobody_knows_are_refused() -> None:
    assert run("completion", "tcsh").code == 2


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("libmodbus-py read h vol --map meter.csv", {"voltage", "current"}),
        ("libmodbus-py read h vol --map=meter.csv -u 3", {"voltage", "current"}),
        ("libmodbus-py read h vol --map", set()),
        ("libmodbus-py read h 'vol --map meter.csv", set()),
        ("libmodbus-py read h vol --map no-such-file.csv", set()),
    ],
)
def test_the_map_may_stand_behind_the_name(
    place: Path, monkeypatch: pytest.MonkeyPatch, line: str, found: set[str]
) -> None:
    monkeypatch.chdir(place)
    monkeypatch.setenv("COMP_LINE", line)
    names = names_of_map(argparse.Namespace(map=None))
    assert set(names) - {*TABLE_WORDS} == found
