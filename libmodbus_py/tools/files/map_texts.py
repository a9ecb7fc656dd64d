"""Register maps as text: in the forms that files have, and as a Python class."""

from __future__ import annotations

import json
import keyword
import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any, get_args

from ...files.csv_text import csv_rows
from ...files.texts import shown_key
from ...maps.list_cells import PADDINGS
from ...maps.point import Point, attribute_names, spelled
from ...maps.register_map import RegisterMap
from ...protocol.words import IntegerType

WHOLE = frozenset(get_args(IntegerType))
"""Types whose values are integers, if they are not scaled."""

WORD_OF = {character: word for word, character in PADDINGS.items()}

_DEFAULTS = {field.name: field.default for field in fields(Point) if field.init}


def toml_text(points: Iterable[Point]) -> str:
    """Return points as TOML: a table for each, with the arguments that are not defaults."""
    return "\n".join(
        "\n".join(
            ["[[point]]", *(f"{key} = {_shown(value)}" for key, value in _arguments(point)), ""]
        )
        for point in points
    )


def csv_text(points: Iterable[Point]) -> str:
    """Return points as CSV: a line for each."""
    rows = [dict(_arguments(point)) for point in points]
    columns = [key for key in _DEFAULTS if any(key in keys for keys in rows)]
    return csv_rows([columns, *([_cell(keys.get(key, "")) for key in columns] for keys in rows)])


def _cell(value: Any) -> Any:
    """Return a value as the readers of cells take it."""
    if isinstance(value, bool):
        return _shown(value)
    if isinstance(value, str) and value in WORD_OF:
        return WORD_OF[value]
    if isinstance(value, list):
        return json.dumps(value)
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    if not isinstance(value, Mapping):
        return value
    if any(set(name) & set(";={") for name in value.values()):
        return json.dumps(value, ensure_ascii=False)
    return "; ".join(f"{key} = {name}" for key, name in value.items())


def _arguments(point: Point) -> list[tuple[str, Any]]:
    return [
        (key, value)
        for key, default in _DEFAULTS.items()
        if (value := getattr(point, key)) is not None and value != default
    ]


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        pairs = (f"{shown_key(str(key))} = {_shown(item)}" for key, item in value.items())
        return f"{{ {', '.join(pairs)} }}"
    # Printable text, numbers and lists are written alike in JSON and TOML.
    return json.dumps(value, ensure_ascii=False)


# --- as a class -----------------------------------------------------------------------------------


MARK = "written by libmodbus-py map class"
"""In the first lines of such a file: only those are overwritten."""

# The methods are in a class of their own, so that no attribute hides the names that they use.
FILE = '''\
"""
{about}
"""
# fmt: off

from __future__ import annotations

from collections.abc import Coroutine{sequence}
{datetime}from typing import (
    TYPE_CHECKING,
    Any,
    Generic,
{literal}    TypedDict,
    TypeVar,
    Unpack,
    overload,
)

from libmodbus_py import Point, RegisterMap
from libmodbus_py.bound import MapBinding

if TYPE_CHECKING:
    from libmodbus_py import AsyncClient, Client

ClientT = TypeVar("ClientT", "Client", "AsyncClient")

{name}Name = {attributes}


class {name}Values(TypedDict, total=False):
    """Values that can be written."""
{values}

MAP = RegisterMap(
    [
{points}    ]
)


class _{name}Requests(MapBinding, Generic[ClientT]):
    def __init__(self, client: ClientT, **options: Any) -> None:
        super().__init__(client, MAP, **options)

    @overload
    def read(
        self: _{name}Requests[Client], *attributes: {name}Name
    ) -> None: ...
    @overload
    def read(
        self: _{name}Requests[AsyncClient], *attributes: {name}Name
    ) -> Coroutine[Any, Any, None]: ...
    def read(self, *attributes: Any) -> Any:
        """Read points, all that can be read unless attributes are named."""
        return self._read(attributes)

    @overload
    def write(
        self: _{name}Requests[Client], **values: Unpack[{name}Values]
    ) -> None: ...
    @overload
    def write(
        self: _{name}Requests[AsyncClient], **values: Unpack[{name}Values]
    ) -> Coroutine[Any, Any, None]: ...
    def write(self, **values: Any) -> Any:
        """Write values; all are checked before the first byte is sent."""
        return self._write(values)


class {name}(_{name}Requests[ClientT]):
    """Values of the last read(); each is written with write()."""
{properties}'''

PROPERTY = '''
    @property
    def {attribute}(self) -> {kind}:
        """
{about}
        """
        value: {kind} = self.{get}({name})
        return value
'''


def class_text(map: RegisterMap, stem: str) -> str:
    """Return a Python file with a class that is named after the stem of the map's file."""
    name = class_name(stem)
    if name in re.findall(r"\w+", FILE):  # which has, or imports, this name
        name += "Map"
    names = attribute_names(map)
    readable = [point for point in map.values() if point.is_readable]
    writable = [point for point in map.values() if point.is_writable]
    words = [f"    {names[point.name]!r},\n" for point in readable]
    values = [
        f"    {names[row.name]}: {_kind(row).replace('list', 'Sequence')}\n" for row in writable
    ]
    has_times = any("datetime" in _kind(point) for point in map.values())
    return FILE.format(
        name=name,
        about=_docstring(f"The points of {stem}, {MARK}.", ""),
        sequence=", Sequence" if any("Sequence" in kind for kind in values) else "",
        datetime="from datetime import datetime\n" if has_times else "",
        literal="    Literal,\n" if words else "",
        attributes=f"Literal[\n{''.join(words)}]" if words else "str",
        values="".join(["\n", *values]) if values else "",
        points="".join(_points(map)),
        properties="".join(_property(point, names[point.name]) for point in readable),
    )


def class_name(stem: str) -> str:
    """Return the name of a class for a file without its ending: ``Sdm630V2`` for "sdm630-v2"."""
    words = [word for word in re.split("_+", spelled(stem)) if word]
    text = "".join(word[0].upper() + word[1:] for word in words) or "Meter"
    text = unicodedata.normalize("NFKC", text)
    return text if text.isidentifier() and not keyword.iskeyword(text) else f"Map{text}"


def _points(map: RegisterMap) -> Iterator[str]:
    for point in map.values():
        yield "        Point(\n"
        for key, default in _DEFAULTS.items():
            value = getattr(point, key)
            if value != default:
                content = dict(value) if isinstance(value, Mapping) else value
                yield f"            {key}={content!r},\n"
        yield "        ),\n"


def _property(point: Point, attribute: str) -> str:
    kind = _kind(point)
    bounds = point.plausible_minimum, point.plausible_maximum
    is_certain = kind != "datetime" and {point.missing, point.scale_from, *bounds} == {None}
    return PROPERTY.format(
        attribute=attribute,
        kind=kind if is_certain else f"{kind} | None",
        about=_docstring(_about(point), " " * 8),
        get="_certain" if is_certain else "_value",
        name=repr(point.name),
    )


def _kind(point: Point) -> str:
    kind = _kind_of_one(point)
    return f"list[{kind}]" if point.count > 1 else kind


def _kind_of_one(point: Point) -> str:
    if point.states is not None:
        return "str | float" if str(point.type).startswith("float") else "str | int"
    if point.bits is not None:
        return "dict[str, int]"
    if point.read.kind is None or (point.bit is not None and ".." not in str(point.bit)):
        return "bool"
    is_whole = not any(factor % 1 for factor in (point.scale, point.offset))
    if point.type in WHOLE:
        return "int" if is_whole and point.scale_from is None else "float"
    if str(point.type).startswith("float"):
        return "float"
    if point.read.kind.is_text or point.type == "eui48":
        return "str"
    if str(point.type).startswith("bits"):
        return "list[bool]"
    return "datetime" if point.read.kind.is_time else "Any"


def _about(point: Point) -> str:
    """Return the text about a point: its type, its unit of measurement, and what it is."""
    many = f"{point.count} values of " if point.count > 1 else ""
    facts = [f"{many}{point.type or 'bit'}"]
    facts += [point.units] if point.units else []
    if point.has_bounds:
        low, high = ("" if limit is None else limit for limit in (point.minimum, point.maximum))
        facts.append(f"{low}..{high}")
    facts += ["read-only"] if not point.is_writable else []
    first = f"{point.name}: {', '.join(facts)}."
    return f"{first}\n\n{point.description}" if point.description else first


def _docstring(text: str, indent: str) -> str:
    """Return a text for the inside of a docstring, which it cannot end."""
    safe = "".join(map(_escaped, text.expandtabs(4)))
    return textwrap.indent("\n".join(map(str.strip, safe.split("\n"))), indent)


def _escaped(character: str) -> str:
    if character in ("\\", '"'):
        return f"\\{character}"
    is_plain = character.isprintable() or character == "\n"
    return character if is_plain else ascii(character)[1:-1]
