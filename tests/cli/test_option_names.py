"""
Options are typed in full: no command takes the beginning of an option for the option.
"""

from __future__ import annotations

import argparse
import contextlib
import io
from collections.abc import Iterator

from libmodbus_py.cli.commands import COMMANDS, parser_of
from tests.support.cases import each_case
from tests.support.commands import run


def parsers(name: str) -> Iterator[argparse.ArgumentParser]:
    """Return the parser of a command, and those of its actions."""
    parser = parser_of(name)
    yield parser
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            yield from action.choices.values()


def beginnings(parser: argparse.ArgumentParser) -> set[str]:
    """Return what begins a long option and is none itself."""
    known = set(parser._option_string_actions)
    flags = [flag for flag in known if flag.startswith("--")]
    assert flags
    return {flag[:end] for flag in flags for end in range(3, len(flag))} - known


@each_case("name", COMMANDS)
def test_no_command_completes_the_beginning_of_an_option(name: str) -> None:
    for parser in parsers(name):
        for action in parser._actions:
            action.required = False
        for text in beginnings(parser):
            with contextlib.redirect_stderr(io.StringIO()), contextlib.suppress(SystemExit):
                _, unknown = parser.parse_known_args([text])
                assert unknown == [text]
                continue
            raise AssertionError(f"{parser.prog} takes {text} for an option")


@each_case(
    ("words", "option"),
    [
        ("read 127.0.0.1:9 holding 0 --time 3", "--time"),
        ("write 127.0.0.1:9 holding 0 1 --typ float32", "--typ"),
        ("map check meter --js", "--js"),
        ("map from-device 127.0.0.1:9 --time 1", "--time"),
        ("serve tcp://127.0.0.1:0 --dev 7", "--dev"),
    ],
)
def test_the_error_names_what_was_typed(words: str, option: str) -> None:
    done = run(*words.split())
    assert done.code == 2
    assert f"unrecognized arguments: {option}" in done.err
