"""
Every --help fits a terminal with 80 columns, has 70 lines at most, and four examples.
"""

from __future__ import annotations

import re

from tests.cli.test_help import PLACES
from tests.support.cases import each_case
from tests.support.commands import run

WITHOUT_EXAMPLES = ("demo",)
"""Commands that take no arguments, so that there is one way to type them."""


@each_case("words", PLACES)
def test_help_fits_a_terminal(words: tuple[str, ...]) -> None:
    for option in ("--help", "--help-all"):
        lines = run(*words, option, environment={"COLUMNS": "80"}).out.splitlines()
        assert [line for line in lines if len(line) > 80] == []
        assert option == "--help-all" or len(lines) <= 70


@each_case("words", [words for words in PLACES if words[:1] != WITHOUT_EXAMPLES])
def test_help_has_four_examples_of_its_own_command(words: tuple[str, ...]) -> None:
    text = run(*words, "--help", environment={"COLUMNS": "80"}).out
    examples = text.partition("\nexamples:\n")[2].partition("\n\n")[0]
    commands = [line for line in examples.splitlines() if "libmodbus-py" in line]
    assert len(commands) == 4
    assert all(line.startswith("  ") for line in examples.splitlines())
    assert "&" not in re.sub("'[^']*'|\"[^\"]*\"", "", examples)  # shells interpret it
    assert any(" ".join(("libmodbus-py", *words)) in line for line in commands)
