"""
Several units, asked one after the other by the same command.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence

from ...client.blocking import Context
from ...protocol.errors import ModbusConnectionError, ModbusError
from ..connecting import endpoint_of
from ..failing import CommandError, advice
from ..output import complain, print_json

__all__ = ["ask_units", "client_of", "fail", "reason_of", "units_of"]


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
