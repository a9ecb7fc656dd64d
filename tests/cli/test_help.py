"""
The text of every --help and --help-all, compared with golden files.

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
    name = "_".join(words) or "libmodbus-py"
    done, whole = (
        run(*words, option, environment={"COLUMNS": "80"}) for option in ("--help", "--help-all")
    )
    assert [done.code, done.err, whole.code, whole.err] == [0, "", 0, ""]
    golden(f"help_{name}.txt", done.out)
    if "--help-all" in done.out:
        golden(f"help-all_{name}.txt", whole.out)
    else:  # there are no rare options
        assert done.out == whole.out
