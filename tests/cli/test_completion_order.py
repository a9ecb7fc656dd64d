"""
Completion whatever the order of the words, as bash and zsh ask argcomplete for it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
from pathlib import Path

import pytest

from libmodbus_py.cli.commands import whole_parser
from libmodbus_py.cli.word_order import options_first
from tests.support.cases import each_case
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


def ordered(text: str) -> str:
    name = text.split()[0]
    return " ".join(options_first(whole_parser([name]), text.split()))


@each_case(
    ("typed", "found"),
    [
        ("read URL --map m -u 3", "read --map m -u 3 URL"),
        ("read URL hr 0 -u", "read URL hr 0 -u"),  # its value is completed
        ("read URL -u 3 hr --type", "read -u 3 URL hr --type"),
        ("read URL --watch hr", "read URL hr"),
        ("read URL --watch 5 hr", "read --watch 5 URL hr"),
        ("read --json URL hr", "read URL hr"),
        ("read --json a.json URL", "read --json a.json URL"),
        ("write URL hr 0 -5 -v", "write -v URL hr 0 -5"),
        ("write URL hr 0 --mask 1", "write URL hr 0 --mask 1"),
        ("write URL hr 0 --mask 1 2", "write --mask 1 2 URL hr 0"),
        ("write URL hr 0 -- -x -u 3", "write URL hr 0 -- -x -u 3"),
        ("read URL --no-such-option -u 3 hr", "read --no-such-option -u 3 URL hr"),
        ("read URL --timeout=3 hr", "read --timeout=3 URL hr"),
        ("map check a.csv -u 3 b.csv", "map check -u 3 a.csv b.csv"),
        ("serve URL --example", "serve URL --example"),
        ("serve URL --page --example x", "serve --example x URL"),
    ],
)
def test_options_come_first(typed: str, found: str) -> None:
    assert ordered(typed) == found


def test_a_parser_without_commands_takes_no_word_for_one() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("word", nargs="*")
    assert options_first(parser, ["read", "-x", "map"]) == ["-x", "read", "map"]
