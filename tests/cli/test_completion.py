"""Completion in real shells and whatever the order of the words."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from libmodbus_py.version import how_to_add
from tests.support.cases import each_case
from tests.support.commands import PROGRAM
from tests.support.programs import run_to_end

argcomplete = pytest.importorskip("argcomplete")


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
    return run_to_end(*command, cwd=place, env=environment)


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("libmodbus-py ident", {"identify"}),
        ("libmodbus-py read --map meter.csv 127.0.0.1 vol", {"voltage"}),
        ("libmodbus-py completion ", {"bash", "zsh", "fish"}),
    ],
)
def test_bash_completes_words(place: Path, line: str, names: set[str]) -> None:
    words = " ".join(f"'{word}'" for word in line.split(" "))
    script = (
        'eval "$(libmodbus-py completion bash)"\n'
        f"COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}; COMP_WORDS=({words})\n"
        "COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 )); COMP_TYPE=9\n"
        "_python_argcomplete libmodbus-py\n"
        'printf "%s\\n" "${COMPREPLY[@]}"\n'
    )
    result = shell(place, ["bash", "-c", script])
    assert result.stderr == ""
    assert {word.strip() for word in result.stdout.split()} - {"--help", "--help-all"} == names


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
def test_fish_completes_commands(place: Path) -> None:
    script = "libmodbus-py completion fish | source; complete -C 'libmodbus-py dia'"
    result = shell(place, ["fish", "--no-config", "-c", script])
    assert [line.partition("\t")[0] for line in result.stdout.splitlines()] == ["diagnose"]


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_zsh_runs_the_script(place: Path) -> None:
    script = 'autoload -U compinit; compinit -D; eval "$(libmodbus-py completion zsh)"'
    script += "; echo $_comps[libmodbus-py]"
    result = shell(place, ["zsh", "-f", "-c", script])
    assert result.stdout.strip().startswith("_python_argcomplete")


def test_without_argcomplete_the_command_says_what_to_install() -> None:
    program = (
        "import sys; sys.modules['argcomplete'] = None\n"
        "from libmodbus_py.cli.main import main; sys.exit(main(['completion', 'bash']))"
    )
    result = run_to_end(sys.executable, "-c", program)
    assert result.returncode == 1
    assert result.stderr == (
        f"libmodbus-py: completion needs argcomplete: {how_to_add('completion')}\n"
    )


@each_case(
    ("line", "words"),
    [
        ("read h --map 'my meter.csv' Lei", ["Leistung L1"]),
        ("read h --map 'my meter.csv' 'Lei", ["Leistung L1"]),
        ('read h --map "my meter.csv" "Lei', ["Leistung L1"]),
        ("read h --map my\\ meter.csv -u 3 s", ["spannung's"]),
        ("127.0.0.1 --map 'my meter.csv' 'Leistung L1' $", ["$x"]),
        ("127.0.0.1 --map 'my me", ["my meter.csv"]),
        ("map check --column name=x my", ["my meter.csv"]),
        ("map list --search sdm1", ["sdm120"]),
    ],
)
def test_quotes_and_spaces_are_completed(place: Path, line: str, words: list[str]) -> None:
    names = ["Leistung L1", "spannung's", "$x"]
    rows = "".join(f"{name},holding,{at}\n" for at, name in enumerate(names))
    (place / "my meter.csv").write_text(f"name,table,address\n{rows}")
    answers = complete(f"libmodbus-py {line}", place, _ARGCOMPLETE_SHELL="bash").split("\013")
    assert [re.sub(r"\\(.)", r"\1", answer).strip() for answer in answers] == words


MAP = "name,table,address\nvoltage,input,0\ncurrent,input,1\n"

LINES = json.loads(Path(__file__).with_name("completions.json").read_text())


def complete(line: str, folder: Path, **shell: str) -> str:
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


@pytest.mark.parametrize(("line", "words"), LINES)
def test_bash_gets_arguments(place: Path, line: str, words: list[str]) -> None:
    answer = complete(f"libmodbus-py {line}", place, _ARGCOMPLETE_SHELL="bash")
    assert sorted({word.strip() for word in answer.split("\013")} - {"--help", ""}) == words


def test_names_of_points_are_completed_if_the_map_is_typed_after_them(place: Path) -> None:
    for line in ("read h vol --map meter.csv", "read h vol --map=meter.csv -u 3"):
        point = str(len("libmodbus-py read h vol"))
        answer = complete(f"libmodbus-py {line}", place, COMP_POINT=point)
        assert answer.strip() == "voltage"
