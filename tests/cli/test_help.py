"""
The text of every --help, compared with a golden file.

`./run test --make-golden tests/cli` writes the files again after a change of texts or options.
"""

from __future__ import annotations

import pytest

from libmodbus_py.cli.commands import COMMANDS
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
def test_help_is_the_golden_file(words: tuple[str, ...], golden: Golden) -> None:
    done = run(*words, "--help", environment={"COLUMNS": "100"})
    assert (done.code, done.err) == (0, "")
    golden(f"help_{'_'.join(words) or 'libmodbus-py'}.txt", done.out)
