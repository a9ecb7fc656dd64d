"""The kinds of outputs in fleet files and of options, and how an output of a kind is made."""

from __future__ import annotations

from typing import Any

from ....files.schema import Keys, keys_of
from .output import Output

KINDS: dict[str, str] = {
    "json": "lines of JSON",
    "csv": "CSV",
    "influx": "line protocol of InfluxDB",
    "mqtt": "",
}
"""
Name -> what is appended to a file, for the help of an option; empty if it needs more than a path.
"""


def output_class(kind: str) -> Any:
    """Return the class of a kind of outputs, whose arguments are keys in fleet files."""
    # Each is imported where it is needed: few fleets have more than one.
    match kind:
        case "json":
            from .line_file import JsonOutput

            return JsonOutput
        case "csv":
            from .line_file import CsvOutput

            return CsvOutput
        case "influx":
            from .influx import Influx

            return Influx
        case "mqtt":
            from .mqtt import Mqtt

            return Mqtt
    raise KeyError(kind)


def output_keys(kind: str) -> Keys:
    return keys_of(output_class(kind))


def make_output(kind: str, keys: dict[str, Any]) -> Output:
    """
    Make an output of a kind with the values of its keys.

    Raises:
        TypeError, ValueError: a key of the wrong name, type or range.
    """
    output: Output = output_keys(kind).read((), keys)
    return output
