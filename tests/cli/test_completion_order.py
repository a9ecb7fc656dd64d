"""
Completion whatever the order of the words, as bash and zsh ask argcomplete for it.
"""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

from tests.support.commands import PROGRAM

pytest.importorskip("argcomplete")

MAP = "name,table,address\nvoltage,input,0\ncurrent,input,1\n"

LINES = [
    ("read 192.0.2.10 -b 9600 --map meter.csv vol", {"voltage"}),
    ("read 192.0.2.10 --map meter.csv -u 3 vol", {"voltage"}),
    ("read 192.0.2.10 voltage -u 3 --map meter.csv cur", {"current"}),
    ("read 192.0.2.10 --map meter.csv --watch vol", {"voltage"}),
    ("read 192.0.2.10 --map meter.csv --watch 5 vol", {"voltage"}),
    ("read 192.0.2.10 --csv --map meter.csv vol", {"voltage"}),
    ("read 192.0.2.10 --csv log.csv --map meter.csv vol", {"voltage"}),
    ("read 192.0.2.10 hr 0 -v hol", {"holding"}),
    ("read -u 3 192.0.2.10 hr 0 --type floa", {"float16", "float32", "float64"}),
    ("read 192.0.2.10 hr 0 -u 3 --order CD", {"CDAB"}),
    ("read 192.0.2.10 hr 0 --encoding latin", {"latin-1"}),
    ("read 192.0.2.10 hr 0 -v --map sdm12", {"sdm120"}),
    ("write 192.0.2.10 --map meter.csv voltage -5 -u 2 cur", {"current"}),
    ("write 192.0.2.10 --mask 0xF0 1 --map meter.csv vol", {"voltage"}),
    ("identify -u 1-9 192.0.2.10 --level ext", {"extended"}),
    ("diagnose 192.0.2.10 -u 1 return-q", {"return-query-data"}),
    ("map check -u 3 sdm120 sdm63", {"sdm630"}),
    ("map class -o meter.py sdm63", {"sdm630"}),
    ("serve 127.0.0.1:1502 --page --example pla", {"plant"}),
    ("scan /dev/ttyUSB0 --deep -p none,ev", {"none,even"}),
    ("gateway 127.0.0.1:1502 --to 192.0.2.10 -p od", {"odd"}),
]


def completed(line: str, folder: Path, **shell: str) -> str:
    """Ask as the function of a shell does: through the environment, with the answer in a file."""
    answer = folder / "answer"
    subprocess.run(
        PROGRAM,
        cwd=folder,
        env={
            **os.environ,
            "COMP_LINE": line,
            "COMP_POINT": str(len(line)),
            "COMP_TYPE": "9",
            "_ARGCOMPLETE": "1",
            "_ARGCOMPLETE_SUPPRESS_SPACE": "1",
            "_ARGCOMPLETE_IFS": "\013",
            "_ARGCOMPLETE_STDOUT_FILENAME": str(answer),
            **shell,
        },
        check=True,
        capture_output=True,
        timeout=60,
    )
    return answer.read_text()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "meter.csv").write_text(MAP)
    return tmp_path


@pytest.mark.parametrize(("line", "found"), LINES)
def test_bash(folder: Path, line: str, found: set[str]) -> None:
    answer = completed(f"libmodbus-py {line}", folder, _ARGCOMPLETE_SHELL="bash")
    assert {each.strip() for each in answer.split("\013")} == found


def test_zsh(folder: Path) -> None:
    line, found = LINES[1]
    answer = completed(f"libmodbus-py {line}", folder, _ARGCOMPLETE_SHELL="zsh")
    assert {each.partition(":")[0] for each in answer.split("\013")} == found
