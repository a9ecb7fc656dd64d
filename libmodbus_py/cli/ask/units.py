"""
Several units, asked one after the other by the same command, and the answers of each: a device may
lack some functions, which are printed, too.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from functools import partial
from typing import Any

from ...client.blocking import Client
from ...protocol import errors
from ...protocol.errors import ExceptionResponse, ModbusConnectionError, ModbusError
from ..arguments import endpoint_of, new_client
from ..main import CommandError, advice
from ..output import complain, print_json

Named = Iterable[tuple[str, Any]]

MAX_SILENT = 4
"""Questions without an answer after which a device that has said nothing is asked no more."""


def units_of(options: argparse.Namespace) -> list[int]:
    """Return the units that were typed, otherwise the unit of the URL, which is 1 by default."""
    if options.units:
        options.unit = options.units[0]
    return options.units or [endpoint_of(options).client_options.get("unit", 1)]


def client_of(context: Client, unit: int) -> Client:
    """Return a client for a unit that shares the connection of another."""
    return context if context.unit == unit else context.for_unit(unit)


def ask_units(
    options: argparse.Namespace,
    ask: Callable[[Client], int | None],
    fail: Callable[[int, str], None],
) -> int:
    """
    Ask each unit that was typed, and return the highest exit code; `ask` may return one. Of several
    units one may fail: `fail` prints it, and why. What a single unit raises is raised, and so is
    that there is no connection.
    """
    units = units_of(options)
    codes = [0]
    with closing(new_client(options)) as context:
        for unit in units:
            try:
                codes.append(ask(client_of(context, unit)) or 0)
            except (ModbusError, CommandError) as error:
                if len(units) == 1 or isinstance(error, ModbusConnectionError):
                    raise
                fail(unit, f"{error}{advice(error)}")
                codes.append(1)
    return max(codes)


def fail(unit: int, reason: str, *, as_json: bool, lacks: str) -> None:
    """Print that one of several units failed; `lacks` names what is missing, such as "values"."""
    if as_json:
        print_json({"unit": unit, "error": reason})
        return
    print(f"unit {unit}: no {lacks}", flush=True)
    complain(reason)


# --- reports -------------------------------------------------------------------------


def report_units(
    options: argparse.Namespace, questions: Mapping[str, Callable[[Client], Named]]
) -> int:
    """Print the answers of each unit that was typed, and return the highest exit code."""
    as_json, several = options.json, len(units_of(options)) > 1
    report = partial(print_report, questions=questions, as_json=as_json, several=several)
    return ask_units(options, report, partial(fail, as_json=as_json, lacks="answer"))


def print_report(
    context: Client,
    questions: Mapping[str, Callable[[Client], Named]],
    *,
    as_json: bool,
    several: bool = False,
) -> None:
    """
    Ask all questions, and print the answers and which of them the device lacks, or why there is
    no answer: it may keep silent, or close the connection, for what it does not know.

    Raises CommandError if there is no answer to any of the questions, ModbusError if there is no
    connection, or the device says nothing at all.
    """
    context.connect()
    answers: dict[str, Any] = {}
    lacking: dict[str, str] = {}
    silent: list[ModbusError] = []
    for name, ask in questions.items():
        try:
            answers.update(ask(context))
        except ModbusError as error:
            lacking[name] = str(error.args[0])
            if not isinstance(error, ExceptionResponse | errors.InvalidResponse):
                silent.append(error)
        has_spoken = answers or len(lacking) > len(silent)
        if not has_spoken and len(silent) == min(MAX_SILENT, len(questions)):
            raise silent[0]
    if not answers:
        raise CommandError(f"unit {context.unit} has none of these: {'; '.join(lacking.values())}")
    texts = {name: _shown(value) for name, value in answers.items()}
    if as_json:
        print_json({"unit": context.unit, **texts, "lacking": lacking})
        return
    if several:
        print(f"unit {context.unit}:")
    lines = {**texts, **{name: f"({reason})" for name, reason in lacking.items()}}
    width = max(map(len, lines))
    for name, text in lines.items():
        print(f"{'  ' * several}{name.replace('_', ' '):<{width}}  {text}")


def _shown(value: Any) -> Any:
    """Return bytes as text if it has no control characters, otherwise in hexadecimal."""
    if not isinstance(value, bytes):
        return value
    is_text = value and all(0x20 <= byte < 0x7F for byte in value)
    return value.decode() if is_text else value.hex(" ")
