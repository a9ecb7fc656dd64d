"""
The text of every --help and --help-all: its golden file, its size, its examples.

`./run test --make-golden tests/cli` writes the files again after a change of texts or options.
"""

import re

import pytest

from libmodbus_py.cli.commands import COMMANDS
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.golden import Golden

NESTED = {"map": ("check", "list", "class", "from-device", "from-sunspec")}
"""Command -> the actions that have a --help of their own."""

PLACES = [
    (),
    *((name,) for name in COMMANDS),
    *((name, action) for name, actions in NESTED.items() for action in actions),
]


@pytest.mark.parametrize("words", PLACES, ids=lambda words: " ".join(words) or "no command")
def test_help_is_the_golden_file_and_fits(words: tuple[str, ...], golden: Golden) -> None:
    name = "_".join(words) or "libmodbus-py"
    result, whole = (
        run(*words, option, environment={"COLUMNS": "80"}) for option in ("--help", "--help-all")
    )
    assert [result.code, result.err, whole.code, whole.err] == [0, "", 0, ""]
    assert max(map(len, (result.out + whole.out).splitlines())) <= 80
    assert result.out.count("\n") <= 70
    golden(f"help_{name}.txt", result.out)
    if "--help-all" in result.out:
        golden(f"help-all_{name}.txt", whole.out)
    else:  # the command has no rare options
        assert result.out == whole.out


WITHOUT_EXAMPLES = ("demo",)
"""Commands that take no arguments, so that there is one way to type them."""


@each_case("words", [words for words in PLACES if words[:1] != WITHOUT_EXAMPLES])
def test_help_has_four_examples_of_its_own_command(words: tuple[str, ...]) -> None:
    text = run(*words, "--help", environment={"COLUMNS": "80"}).out
    examples = text.partition("\nexamples:\n")[2].partition("\n\n")[0]
    commands = [line for line in examples.splitlines() if "libmodbus-py" in line]
    assert len(commands) == 4
    assert all(line.startswith("  ") for line in examples.splitlines())
    assert "&" not in re.sub("'[^']*'|\"[^\"]*\"", "", examples)  # shells interpret it
    assert any(" ".join(("libmodbus-py", *words)) in line for line in commands)
