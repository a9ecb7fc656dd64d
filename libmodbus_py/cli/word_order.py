"""
The words of a command in the order in which argparse understands them best: options first.

argparse gives the words after an option to no positional argument if there was a chance before,
so that nothing would be completed in ``read URL --map FILE -u 3 NAME``.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

__all__ = ["options_first"]


def options_first(parser: argparse.ArgumentParser, words: Sequence[str]) -> list[str]:
    """
    Return the words typed before the one that is completed, options first.

    An option whose value is completed stays at the end. A command or an action stays before its
    own options. Options whose value may be missing, and is, are left out.

    Args:
        parser: of the words.
    """
    if "--" in words:
        return [*words]
    options: list[str] = []
    others: list[str] = []
    at = 0
    while at < len(words):
        word = words[at]
        at += 1
        if not _is_option(parser, word):
            others.append(word)
            if chosen := _parsers(parser).get(word):
                return [*options, word, *options_first(chosen, words[at:])]
            continue
        action = parser._option_string_actions.get(word)
        values = _values(action, words[at:])
        at += len(values)
        if action is not None and at == len(words) and _has_room(action, len(values)):
            return [*options, *others, word, *values]
        is_bare = action is not None and action.nargs == "?" and not values
        if not is_bare:  # which would take the word behind it now
            options += [word, *values]
    return [*options, *others]


def _parsers(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of the commands or actions that a parser has."""
    return {
        name: each
        for action in parser._actions
        if action.nargs == argparse.PARSER
        for name, each in dict(action.choices or {}).items()
    }


def _is_option(parser: argparse.ArgumentParser, word: str) -> bool:
    is_number = parser._negative_number_matcher.match(word)
    return len(word) > 1 and word.startswith("-") and not is_number


def _least(action: argparse.Action) -> int:
    """Return how many values an option needs."""
    if action.nargs is None:
        return 1
    return action.nargs if isinstance(action.nargs, int) else 0


def _has_room(action: argparse.Action, count: int) -> bool:
    """Return True if an option takes another value after those that were typed."""
    is_completed = action.nargs == "?" and hasattr(action, "completer")
    return count < (1 if is_completed else _least(action))


def _values(action: argparse.Action | None, words: Sequence[str]) -> Sequence[str]:
    """Return the values of an option, at the beginning of the words behind it."""
    if action is None:  # not known, or with = and its value
        return ()
    if action.nargs == "?":
        first = words[0] if words else "-"
        return () if first.startswith("-") or not _is_taken(action, first) else words[:1]
    return words[: _least(action)]


def _is_taken(action: argparse.Action, word: str) -> bool:
    """Return True if an option that needs no value takes this word as one."""
    from .arguments import is_form, is_of_form

    if is_form(action):
        return is_of_form(word)
    convert = action.type if callable(action.type) else str
    try:
        convert(word)
    except (ValueError, TypeError, argparse.ArgumentTypeError):
        return False
    return True
