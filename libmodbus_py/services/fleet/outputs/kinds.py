"""
The kinds of outputs: a row for each.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, NamedTuple

from ....tools.files.schema import Keys, keys_of
from .output import Output

__all__ = ["KINDS", "made", "output_keys"]


class OutputKind(NamedTuple):
    """
    One kind of outputs.

    Attributes:
        module: its file in this folder, imported when an output is made.
        name: its class. The arguments of the class are the keys in fleet files.
        form: what it appends to a file, for the help of an option of the command line; empty if
            it needs more than a path.
    """

    module: str
    name: str
    form: str = ""


KINDS: dict[str, OutputKind] = {
    "json": OutputKind("file_outputs", "JsonOutput", "lines of JSON"),
    "csv": OutputKind("file_outputs", "CsvOutput", "CSV"),
    "influx": OutputKind("influx", "Influx", "line protocol of InfluxDB"),
    "mqtt": OutputKind("mqtt", "Mqtt"),
}
"""Name in fleet files and of options -> the kind."""


def output_keys(kind: str) -> Keys:
    """Return the keys that a kind of outputs has in a fleet file."""
    row = KINDS[kind]
    return keys_of(getattr(import_module(f".{row.module}", __package__), row.name))


def made(kind: str, keys: dict[str, Any]) -> Output:
    """
    Make an output.

    Raises:
        TypeError, ValueError: a key of the wrong name, type or range.
    """
    output: Output = output_keys(kind).read((), keys)
    return output
