"""
The kinds of outputs, by the names that files and options have for them.
"""

from __future__ import annotations

import inspect
from importlib import import_module
from typing import Any

from .output import Output

__all__ = ["KINDS", "keys_of", "made"]

KINDS: dict[str, tuple[str, str]] = {
    "json": ("json_lines", "JsonLines"),
    "csv": ("csv_rows", "CsvRows"),
    "mqtt": ("mqtt", "Mqtt"),
    "nats": ("nats", "Nats"),
}
"""Name -> its file and its class, whose arguments are the keys."""


def _class(kind: str) -> Any:
    module, name = KINDS[kind]
    return getattr(import_module(f".{module}", __package__), name)


def keys_of(kind: str) -> list[str]:
    """Give what it can be told."""
    return list(inspect.signature(_class(kind)).parameters)


def made(kind: str, keys: dict[str, Any]) -> Output:
    """
    Make one.

    Raises:
        TypeError, ValueError: a key of the wrong name, type or range.
    """
    needed = inspect.signature(_class(kind)).parameters.values()
    for each in needed:
        if each.default is each.empty and each.name not in keys:
            raise ValueError(f"{each.name} is missing")
    output: Output = _class(kind)(**keys)
    return output
