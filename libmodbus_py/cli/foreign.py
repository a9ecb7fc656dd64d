"""
Words of other programs that are typed here: their options, and names of serial ports.

mbpoll, modpoll and modbus-cli have options of one letter for what is a part of the URL or of WHAT
here. An option that a command has itself is looked up only with a value that it cannot have, such
as ``-p 1502``.
"""

from __future__ import annotations

import argparse
import re

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

__all__ = ["equivalents", "is_place", "place"]

TABLES = {"0": "co", "1": "di", "3": "ir", "4": "hr"}
"""Number of a table in mbpoll and modpoll -> its word here."""

FUNCTIONS = {"1": "co N", "2": "di N", "3": "hr N", "4": "ir N"}
FUNCTIONS |= dict.fromkeys(("5", "15"), "write HOST co N VALUE")
FUNCTIONS |= dict.fromkeys(("6", "16"), "write HOST hr N VALUE")
"""Function code -> what reads or writes with it."""

TYPES = {"int": "int32", "float": "float32", "string": "string:N"}
"""Type in mbpoll and modpoll -> --type; without their -B, both have the order CDAB."""

FRAMINGS = {
    "tcp": "HOST, or tcp://HOST",
    "udp": "udp://HOST",
    "enc": "rtu+tcp://HOST:PORT",
    "rtu": "/dev/ttyUSB0",
    "ascii": "ascii:///dev/ttyUSB0",
}
"""Argument of -m -> the URL."""


def _place(value: str) -> str:
    if value.isdecimal() and 1 <= int(value) <= 65536:
        return f"hr {int(value) - 1} or {400000 + int(value)}, because hr counts from 0"
    return "hr N, or a reference such as 40001"


def _kind(value: str) -> str:
    table, _, kind = value.partition(":") if value[:1].isdecimal() else ("4", "", value)
    where = TABLES.get(table, "hr")
    if not kind:
        return f"{where} N"
    if kind == "hex":
        return f"{where} N --hex"
    order = " --order CDAB" if kind in ("int", "float") else ""
    return f"{where} N --type {TYPES.get(kind, kind)}{order}"


def _unit(value: str) -> str:
    return f"-u {value.replace(':', '-') or 'N'}"


def _port(value: str) -> str:
    return f"HOST:{value or 'PORT'}"


def _as(text: str) -> Callable[[str], str]:
    """Return a function whose answer has the value that was typed in place of VALUE."""
    return lambda value: text.replace("VALUE", value or "N")


OPTIONS: dict[str, Callable[[str], str]] = {
    **dict.fromkeys(("-m", "--mode"), lambda value: FRAMINGS.get(value, "a URL, tcp://HOST")),
    **dict.fromkeys(("-a", "--slave", "--id", "--unit-id", "--slave-id", "--address"), _unit),
    **dict.fromkeys(("-r", "--register", "--reference", "--start"), _place),
    "-c": _as("hr N VALUE, with the number of values behind the address"),
    "-t": _kind,
    **dict.fromkeys(("-B", "-f", "-i"), _as("no --order, because ABCD is the default")),
    "-0": _as("hr 0, which counts from 0"),
    "-1": _as("nothing, because a read without --watch polls once"),
    "-l": _as("--watch VALUEms"),
    "-o": _as("--timeout VALUE"),
    "-P": _as("-p VALUE"),
    "-R": _as("--rs485 rts-down"),
    "-F": _as("--rs485 rts-up"),
    "-4": _as("--rs485 kernel"),
    "--port": _port,
    **dict.fromkeys(("--host", "--ip"), _as("VALUE without an option")),
    "--function": lambda value: FUNCTIONS.get(value, f"raw HOST {value}".rstrip()),
    "--baud": _as("-b VALUE"),
}
"""Option of another program -> function of its value that returns what is typed here."""

TAKEN = {
    "-p": (re.compile("[0-9]+"), _port),
    "--parity": (re.compile("[0-9]+"), _port),
    "-s": (re.compile("(?![12]$)[0-9]+"), _unit),
}
"""Option that is one here, too -> the values that it has only there, and what is typed here."""

SWITCHES = ("-B", "-f", "-i", "-0", "-1", "-R", "-F")
"""Options without a value."""


def equivalents(parser: argparse.ArgumentParser, words: Sequence[str]) -> str:
    """
    Return a message about the options that are those of another program, and not of the command
    whose parser it is, among the words behind it; empty if none is.
    """
    found: list[str] = []
    words = words[: words.index("--")] if "--" in words else words
    for at, typed in enumerate(words):
        word, _, value = typed.partition("=")
        following = words[at + 1] if at + 1 < len(words) else ""
        if word not in SWITCHES and not value and not following.startswith("-"):
            value = following
        if word in TAKEN and TAKEN[word][0].fullmatch(value):
            answer = TAKEN[word][1](value)
        elif word in OPTIONS and _is_foreign(parser, word, words[:at]):
            answer = OPTIONS[word](value)
        else:
            continue
        found.append(f"{f'{word} {value}'.rstrip()}: type {answer}")
    return "; ".join(found)


def _is_foreign(parser: argparse.ArgumentParser, word: str, before: Sequence[str]) -> bool:
    """Return True unless a word is an option here, or a number such as -1 that is a value."""
    known = parser._option_string_actions
    if word in known or not word[1:].isdecimal():
        return word not in known
    if not before or parser.prog.endswith(" write"):
        return not before
    from ..protocol.words import table_named

    option = known.get(before[-1])
    is_value = option is not None and option.nargs != 0
    return not is_value and table_named(before[-1]) is None


_PORT_NAME = re.compile(r"tty[A-Za-z]{1,4}[0-9]+(?:\?.*)?")


def is_place(word: str) -> bool:
    """Return True if a word can only be a device: a URL, an address, a path, or a serial port."""
    return word == "localhost" or not {":", "/", "."}.isdisjoint(word) or place(word) != word


def place(text: str) -> str:
    """Return a URL as it was typed; the name of a serial port such as ttyUSB0 becomes its path."""
    return f"/dev/{text}" if _PORT_NAME.fullmatch(text) else text
