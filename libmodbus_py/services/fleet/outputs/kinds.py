"""
The kinds of outputs, by the names that files and options have for them.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from ....tools.files.schema import Keys, keys_of
from .output import Output

__all__ = ["KINDS", "made", "output_keys"]

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


def output_keys(kind: str) -> Keys:
    """Return the keys of a kind of outputs, of which one is made."""
    return keys_of(_class(kind))


def made(kind: str, keys: dict[str, Any]) -> Output:
    """
    Make an output.

    Raises:
        TypeError, ValueError: a key of the wrong name, type or range.
    """
    output: Output = output_keys(kind).read((), keys)
    return output
