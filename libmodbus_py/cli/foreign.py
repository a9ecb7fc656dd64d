"""
Words of other programs that are typed here: their options, and names of serial ports.

mbpoll, modpoll and modbus-cli have options of one letter for what is a part of the URL or of WHAT
here. An option that a command has itself is looked up only with a value that it cannot have, such
as ``-p 1502``.
"""

from __future__ import annotations

import re

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from typing import Any

UNIT = "-u VALUE"
PORT = "HOST:VALUE"
URL = "HOST, udp://HOST, rtu+tcp://HOST:PORT, /dev/ttyUSB0 or ascii:///dev/ttyUSB0"
PLACE = "hr N, which counts from 0, or a reference such as 40001"
KIND = "co, di, ir or hr N for 0, 1, 3 or 4; --hex, or --type, with --order CDAB for int and float"
ORDER = "--order CDAB for the low word first, BADC for the low byte first, DCBA for both"
FUNCTION = "co, di, hr or ir N for 1 to 4, write HOST co N or hr N to write, raw HOST N for others"

OPTIONS = {
    **dict.fromkeys(("-m", "--mode"), URL),
    **dict.fromkeys(("-a", "--slave", "--id", "--unit-id", "--slave-id", "--address"), UNIT),
    **dict.fromkeys(("-r", "--register", "--reference", "--start"), PLACE),
    "-c": "hr N VALUE, with the number of values behind the address",
    "-t": KIND,
    **dict.fromkeys(("-B", "-f", "-i"), "no --order, because ABCD is the default"),
    "-0": "hr 0, which counts from 0",
    "-1": "nothing, because a read without --watch polls once",
    "-l": "--watch VALUEms",
    "-o": "--timeout VALUE",
    "-P": "-p VALUE",
    "-R": "--rs485 rts-down",
    "-F": "--rs485 rts-up",
    "-4": "--rs485 kernel",
    "--port": PORT,
    **dict.fromkeys(("--host", "--ip"), "VALUE without an option"),
    "--function": FUNCTION,
    "--baud": "-b VALUE",
    "--format": "--hex, --json or --csv",
    **dict.fromkeys(("--swap", "--word-order", "--byte-order", "--endian"), ORDER),
    "--float": "hr N:float32",
    "--registers": "hr N COUNT to read them, or scan --deep to find them",
    "--log-level": "--log VALUE",
    "--for": "timeout VALUE before libmodbus-py",
    "--bit": "hr N.VALUE, a bit of a register, of which 0 is the lowest",
}
"""Option of another program -> what is typed here; VALUE stands for its value."""

TAKEN = {"-p": ("[0-9]+", PORT), "--parity": ("[0-9]+", PORT), "-s": ("(?![12]$)[0-9]+", UNIT)}
"""Option that is one here, too -> the values that it has only there, and what is typed here."""

SWITCHES = ("-B", "-f", "-i", "-0", "-1", "-R", "-F", "--swap", "--float", "--registers")
"""Options without a value."""

COMMANDS = {
    "help": "COMMAND --help",
    "version": "--version",
    **dict.fromkeys(("watch", "monitor"), "read ... --watch"),
    **dict.fromkeys(("simulate", "simulator", "server", "slave"), "serve"),
    **dict.fromkeys(("sniff", "sniffer", "spy"), "listen"),
    "discover": "scan",
}
"""Command of another program -> what is typed here."""


def equivalents(command: str, flags: Mapping[str, Any], words: Sequence[str]) -> str:
    """
    Return a message about the options that are those of another program, and not among the `flags`
    of the command, in the words behind it; empty if none is.
    """
    hints: list[str] = []
    words = words[: words.index("--")] if "--" in words else words
    for at, argument in enumerate(words):
        word, _, value = argument.partition("=")
        following = words[at + 1] if at + 1 < len(words) else ""
        if word not in SWITCHES and not value and not following.startswith("-"):
            value = following
        if word in TAKEN and re.fullmatch(TAKEN[word][0], value):
            answer = TAKEN[word][1]
        elif word in OPTIONS and _is_foreign(command, flags, word, words[:at]):
            answer = OPTIONS[word]
        else:
            continue
        hints.append(f"{f'{word} {value}'.rstrip()}: type {_of_value(answer, value)}")
    return "; ".join(hints)


def _of_value(answer: str, value: str) -> str:
    """Return what is typed for a value of an option."""
    if answer == PLACE and value.isdecimal() and int(value) > 0:
        return f"hr {int(value) - 1}, because hr counts from 0"
    value = value.replace(":", "-") if answer == UNIT else value
    return answer.replace("VALUE", value or "N")


def _is_foreign(command: str, flags: Mapping[str, Any], word: str, before: Sequence[str]) -> bool:
    """Return True unless a word is an option of this command, or a number such as -1."""
    if word in flags or not word[1:].isdecimal():
        return word not in flags
    if not before or command == "write":
        return not before
    from ..protocol.words import table_named

    option = flags.get(before[-1])
    is_value = option is not None and option.nargs != 0
    return not is_value and table_named(before[-1]) is None


_PORT_NAME = re.compile(r"tty[A-Za-z]{1,4}[0-9]+(?:\?.*)?")


def is_place(word: str) -> bool:
    """Return True if a word can only be a device: a URL, an address, a path, or a serial port."""
    return word == "localhost" or not {":", "/", "."}.isdisjoint(word) or place(word) != word


def place(text: str) -> str:
    """Return a URL as it was typed; the name of a serial port such as ttyUSB0 becomes its path."""
    return f"/dev/{text}" if _PORT_NAME.fullmatch(text) else text
