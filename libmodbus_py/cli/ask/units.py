"""
Several units, asked one after the other by the same command, and the answers of each: a device may
lack some functions, which are printed, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from functools import partial
from typing import Any

from ...client.blocking import Context
from ...protocol.errors import (
    ExceptionResponse,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
)
from ..connecting import connected, endpoint_of
from ..failing import CommandError, advice
from ..output import complain, print_json

# fmt: off
__all__ = [
    "Named", "ask_units", "client_of", "fail", "print_report", "reason_of", "report_units",
    "units_of",
]
# fmt: on

Named = Iterable[tuple[str, Any]]

MAX_SILENT = 4
"""Questions without an answer after which a device that has said nothing is asked no more."""


def units_of(options: argparse.Namespace) -> list[int]:
    """
    Return the units that were typed, otherwise the unit of the URL, which is 1 by default.

    Raises:
        ValueError: the URL or an option is wrong.
    """
    if options.units:
        options.unit = options.units[0]
    return options.units or [endpoint_of(options).client_options.get("unit", 1)]


def client_of(context: Context, unit: int) -> Context:
    """Return a client for a unit that shares the connection of another."""
    return context if context.unit == unit else context.for_unit(unit)


def ask_units(
    units: Sequence[int], ask: Callable[[int], int], fail: Callable[[int, str], None]
) -> int:
    """
    Ask each unit, and return the highest exit code. Of several units one may fail.

    Args:
        ask: asks a unit, prints the answers, and returns the exit code.
        fail: prints that a unit failed, and why.

    Raises:
        ModbusError, CommandError: as of `ask`, if there is one unit.
        ModbusConnectionError: there is no connection.
    """
    codes = [0]
    for unit in units:
        try:
            codes.append(ask(unit))
        except (ModbusError, CommandError) as error:
            if len(units) == 1 or isinstance(error, ModbusConnectionError):
                raise
            fail(unit, reason_of(error))
            codes.append(1)
    return max(codes)


def reason_of(error: ModbusError | CommandError) -> str:
    """Return why a unit failed, and what to try."""
    return f"{error}{advice(error)}" if isinstance(error, ModbusError) else str(error)


def fail(unit: int, reason: str, *, as_json: bool, lacks: str) -> None:
    """
    Print that one of several units failed.

    Args:
        lacks: what there is none of, such as "values".
    """
    if as_json:
        print_json({"unit": unit, "error": reason})
        return
    print(f"unit {unit}: no {lacks}", flush=True)
    complain(reason)


# --- reports -------------------------------------------------------------------------


def report_units(options: argparse.Namespace, report: Callable[[Context, bool], int]) -> int:
    """
    Report about each unit that was typed, and return the highest exit code.

    Args:
        report: asks a client and prints; its second argument is True if there are several units.
    """
    units = units_of(options)
    with closing(connected(options)) as context:
        return ask_units(
            units,
            lambda unit: report(client_of(context, unit), len(units) > 1),
            partial(fail, as_json=options.json, lacks="answer"),
        )


def print_report(
    context: Context,
    questions: Mapping[str, Callable[[], Named]],
    *,
    as_json: bool,
    several: bool = False,
) -> int:
    """
    Ask all questions, and print the answers and which of them the device lacks, or why there is
    no answer: it may keep silent, or close the connection, for what it does not know.

    Args:
        questions: name -> function that asks, and returns names and values.
        several: True if other units are asked too, so that the unit is named.

    Raises:
        CommandError: the device has no answer to any of the questions.
        ModbusError: there is no connection, or the device says nothing at all.
    """
    context.connect()
    answers: dict[str, Any] = {}
    lacking: dict[str, str] = {}
    silent: list[ModbusError] = []
    for name, ask in questions.items():
        try:
            answers.update(ask())
        except ModbusError as error:
            lacking[name] = str(error.args[0])
            if not isinstance(error, ExceptionResponse | InvalidResponse):
                silent.append(error)
        has_spoken = answers or len(lacking) > len(silent)
        if not has_spoken and len(silent) == min(MAX_SILENT, len(questions)):
            raise silent[0]
    if as_json and (answers or not several):
        plain = {
            name: _shown(value) if isinstance(value, bytes) else value
            for name, value in answers.items()
        }
        print_json({"unit": context.unit, **plain, "lacking": lacking})
    if not answers:
        raise CommandError(f"unit {context.unit} has none of these: {'; '.join(lacking.values())}")
    if not as_json:
        _print_lines(answers, lacking, f"unit {context.unit}:" * several)
    return 0


def _print_lines(answers: dict[str, Any], lacking: dict[str, str], heading: str) -> None:
    if heading:
        print(heading)
    lines = {name: _shown(value) for name, value in answers.items()}
    lines |= {name: f"({reason})" for name, reason in lacking.items()}
    width = max(map(len, lines))
    for name, text in lines.items():
        print(f"{'  ' * bool(heading)}{name.replace('_', ' '):<{width}}  {text}")


def _shown(value: Any) -> str:
    """Return a value as text without control characters; other bytes are hexadecimal."""
    if isinstance(value, bytes):
        is_text = value and all(0x20 <= byte < 0x7F for byte in value)
        return value.decode() if is_text else value.hex(" ")
    return str(value)
