"""
Colour in errors: on terminals only, and only if the user wants it.
"""

from __future__ import annotations

import re

from tests.support.cases import each_case
from tests.support.commands import on_terminal, run


def shown_on_terminal(*words: str, **environment: str) -> str:
    with on_terminal(*words, environment={"NO_COLOR": "", **environment}) as terminal:
        return terminal.read_to_end().replace("\r\n", "\n")


def without_styles(text: str) -> str:
    return re.sub(r"\x1b\[[0-9;]*m", "", text)


@each_case(
    "words",
    [
        ("read", "192.0.2.10", "nonsense"),  # found by the command
        ("read", "--nonsense"),  # by argparse
        ("nonsense",),
        ("read", "127.0.0.1:1", "hr", "0"),  # by the system
    ],
)
def test_an_error_begins_in_red(words: tuple[str, ...]) -> None:
    shown = shown_on_terminal(*words)
    assert shown.startswith("\x1b[1;31mlibmodbus-py:\x1b[0m ")
    assert without_styles(shown) == run(*words).err


@each_case("environment", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_colour_is_left_out_where_it_is_not_wanted(environment: dict[str, str]) -> None:
    assert "\x1b" not in shown_on_terminal("read", "--nonsense", **environment)


def test_colour_of_errors_follows_stderr() -> None:
    assert "\x1b" not in run("read", "--nonsense").err
