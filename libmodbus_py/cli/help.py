"""
The layout of --help: as wide as the terminal, and the same in all versions of Python.

--help leaves out options that few people need, and --help-all shows them, too. argparse asks
shutil for the width, which imports three compressors at each start.
"""

from __future__ import annotations

import argparse
import os

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any

__all__ = ["Help", "HelpAll", "VerbatimHelp", "hide_rare", "make_rare", "tell_defaults"]


class Help(argparse.HelpFormatter):
    """Formats help: every text fills the width, and the usage line names no single options."""

    def __init__(self, prog: str, **options: Any) -> None:
        super().__init__(prog, **{"width": _columns() - 2, **options})

    def add_argument(self, action: argparse.Action) -> None:
        super().add_argument(action)
        # As Python 3.13 does: commands count with their indentation.
        for each in self._iter_indented_subactions(action):
            length = len(self._format_action_invocation(each)) + self._current_indent
            self._action_max_length = max(self._action_max_length, length)

    def _format_usage(
        self, usage: Any, actions: Iterable[argparse.Action], groups: Any, prefix: str | None
    ) -> str:
        if usage is not None:  # argparse made it before it hides positional arguments
            return f"usage: {usage.strip()}\n\n"
        start = "usage: " if prefix is None else prefix
        actions = list(actions)
        needed = [action for action in actions if action.required or not action.option_strings]
        has_options = any(not action.required and action.option_strings for action in actions)
        words = [self._prog, *["[OPTIONS]"] * has_options, *map(self._usage_of, needed)]
        return f"{start}{' '.join(words)}\n\n"

    def _usage_of(self, action: argparse.Action) -> str:
        if not action.option_strings:
            return self._format_args(action, self._get_default_metavar_for_positional(action))
        return f"{action.option_strings[-1]} {action.metavar}"

    def _format_action_invocation(self, action: argparse.Action) -> str:
        """As newer versions of Python: -u, --unit N."""
        if not action.option_strings or action.nargs == 0:
            return super()._format_action_invocation(action)
        default = self._get_default_metavar_for_optional(action)
        return f"{', '.join(action.option_strings)} {self._format_args(action, default)}"


class VerbatimHelp(Help, argparse.RawDescriptionHelpFormatter):
    """Help whose description and epilog stay as they are."""


class HelpAll(argparse.Action):
    """The option --help-all."""

    def __call__(self, parser: Any, *_: Any) -> None:
        parser.shows_all = True
        parser.print_help()
        parser.exit()


def make_rare(*actions: argparse.Action) -> None:
    """Let options be shown by --help-all only."""
    for action in actions:
        action.is_rare = True  # type: ignore[attr-defined]


def hide_rare(parser: argparse.ArgumentParser, *, shows_all: bool) -> None:
    """Leave rare options out of the help unless all are shown, and --help-all if there are none."""
    groups = [
        [each for each in group._group_actions if getattr(each, "is_rare", False)]
        for group in parser._action_groups
    ]
    rare = [each for group in groups for each in group]
    # A rare option of the first and of the last group.
    names = [group[0].option_strings[0] for group in groups if group]
    some = ", ".join(dict.fromkeys([*names[:1], *names[-1:]]))
    for action in parser._actions:
        if isinstance(action, HelpAll):
            action.help = f"show rare options, too: {some}, ..." if rare else argparse.SUPPRESS
    for action in [] if shows_all else rare:
        action.help = argparse.SUPPRESS


def tell_defaults(parser: argparse.ArgumentParser) -> None:
    """Add the default values to the help texts of a parser."""
    for action in parser._actions:
        usual = action.__dict__.pop("usual", None)
        if usual is not None and (text := _shown(usual(action.dest))):
            action.help = f"{action.help} ({text})"


def _shown(value: Any) -> str:
    if value is None or isinstance(value, bool):
        return ""
    return f"{value:g}" if isinstance(value, float) else str(value)


def _columns() -> int:
    given = os.environ.get("COLUMNS", "")
    try:
        return int(given) if given.isdecimal() else os.get_terminal_size(1).columns or 80
    except OSError:
        return 80
