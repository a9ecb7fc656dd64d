"""
The command completion, and the answers to shells that complete.
"""

from __future__ import annotations

import argparse
import os
from typing import Any

from .commands import COMMANDS, whole_parser
from .help import VerbatimHelp
from .output import PROGRAM
from .word_order import options_first

__all__ = ["add_command", "complete"]

SHELLS = ("bash", "zsh", "fish")

EXAMPLES = """\
examples:
  eval "$(libmodbus-py completion bash)"   # in ~/.bashrc
  eval "$(libmodbus-py completion zsh)"    # in ~/.zshrc
  libmodbus-py completion fish | source    # in ~/.config/fish/config.fish
  libmodbus-py completion fish > ~/.config/fish/completions/libmodbus-py.fish"""


def add_command(commands: Any) -> None:
    """Add the command to argparse."""
    command = commands.add_parser(
        "completion",
        description="Print a script that makes a shell complete commands, options and names.",
        epilog=EXAMPLES,
        formatter_class=VerbatimHelp,
    )
    command.add_argument(
        "shell", choices=SHELLS, metavar="SHELL", help=f"one of {', '.join(SHELLS)}"
    )
    command.set_defaults(run=_print)


def _print(options: argparse.Namespace) -> int:
    argcomplete = _argcomplete()
    print(argcomplete.shellcode([PROGRAM], shell=options.shell))
    return 0


def complete() -> None:
    """
    Answer a shell that asks for completions through the environment, and exit.

    Raises:
        ImportError: argcomplete is not installed.
    """
    words = os.environ.get("COMP_LINE", "").split()
    asked = [word for word in words[1:2] if word in COMMANDS]
    argcomplete = _argcomplete()

    class AnyOrder(argcomplete.CompletionFinder):  # type: ignore[misc, name-defined]
        """Completes words wherever they stand."""

        def _get_completions(self, comp_words: list[str], *others: Any) -> Any:
            program, *typed = comp_words
            return super()._get_completions([program, *options_first(parser, typed)], *others)

    parser = whole_parser(asked)
    AnyOrder()(parser, always_complete_options="long")


def _argcomplete() -> Any:
    try:
        import argcomplete
    except ImportError:
        raise ImportError(
            "completion needs argcomplete: pip install 'libmodbus-py[completion]'"
        ) from None
    return argcomplete
