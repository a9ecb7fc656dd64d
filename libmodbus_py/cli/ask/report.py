"""
Answers to several functions, of which a device may lack some, as text or JSON.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from functools import partial
from typing import Any

from ...client.blocking import Context
from ...protocol.errors import ExceptionResponse, InvalidResponse, ModbusError
from ..connecting import connected
from ..failing import CommandError
from ..output import print_json
from .units import ask_units, client_of, fail, units_of

__all__ = ["Named", "print_report", "report_units"]

Named = Iterable[tuple[str, Any]]

# Questions without an answer after which a device that has said nothing is asked no more.
MOST_SILENT = 4


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
        if not has_spoken and len(silent) == min(MOST_SILENT, len(questions)):
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
