"""The command completion, and the answers to shells that complete."""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from typing import Any

from .commands import COMMANDS, whole_parser
from .foreign import is_place
from .output import PROGRAM
from .parser import Parser, declare

SHELLS = ("bash", "zsh", "fish")

EXAMPLES = """\
examples:
  eval "$(libmodbus-py completion bash)"   # in ~/.bashrc
  eval "$(libmodbus-py completion zsh)"    # in ~/.zshrc
  libmodbus-py completion fish | source    # in ~/.config/fish/config.fish
  libmodbus-py completion fish > ~/.config/fish/completions/libmodbus-py.fish"""


def add_command(command: Parser) -> None:
    command.description = "Print a script that makes a shell complete commands, options and names."
    command.epilog = EXAMPLES
    declare(command, f"SHELL\n  one of {', '.join(SHELLS)}", shell={"choices": SHELLS})
    command.set_defaults(run=_print)


def _print(options: argparse.Namespace) -> int:
    argcomplete = _argcomplete()
    print(argcomplete.shellcode([PROGRAM], shell=options.shell))
    return 0


def complete() -> None:
    """Answer a shell that asks for completions through the environment, and exit."""
    line, end = os.environ.get("COMP_LINE", ""), int(os.environ.get("COMP_POINT", "0"))
    name, _, others = line.partition(" ")
    if is_place(others.split(" ")[0]):  # the command read, which may be left out
        line, end = f"{name} read {others}", end + len("read ")
        os.environ |= {"COMP_LINE": line, "COMP_POINT": str(end)}
    parser = whole_parser([word for word in line.split()[1:2] if word in COMMANDS])
    behind = line.encode()[end:].decode(errors="replace").split()
    argcomplete = _argcomplete()

    class WithoutOptions(argcomplete.CompletionFinder):  # type: ignore[misc, name-defined]
        def _get_completions(self, comp_words: list[str], *others: Any) -> Any:
            parser.set_defaults(words=[*comp_words, *behind])  # for completers
            return super()._get_completions(_without_options(parser, comp_words), *others)

    WithoutOptions()(parser, always_complete_options="long")


def _without_options(parser: Parser, words: Sequence[str]) -> list[str]:
    """
    Return the words before the one that is completed, without options and their values.

    argparse gives no words after an option to a positional argument that may be missing, so that
    nothing would be completed in ``read URL -u 3 NAME``. An option whose value is completed stays.
    """
    flags = _flags(parser)
    others: list[str] = []
    at = 0
    while at < len(words):
        action = flags.get(words[at])
        if action is None:
            others.append(words[at])
            at += 1
            continue
        count = 1 if action.nargs is None else action.nargs
        end = at + 1 + (count if isinstance(count, int) else 0)
        may_have_one = action.nargs in ("?", "+") and hasattr(action, "completer")
        if end > len(words) or (may_have_one and end == len(words)):
            return [*others, *words[at:]]
        at = end
    return others


def _flags(parser: Parser) -> dict[str, argparse.Action]:
    flags = parser.flags
    for command in parser.commands.values():
        flags |= _flags(command)
    return flags


def _argcomplete() -> Any:
    try:
        import argcomplete
    except ImportError:
        from ..version import what_is_missing

        raise ImportError(what_is_missing("completion", "completion")) from None
    return argcomplete
