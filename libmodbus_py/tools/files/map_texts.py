"""
Register maps as text: in the forms that files have, and as a Python class.
"""

from __future__ import annotations

import json
import keyword
import math
import re
import textwrap
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields
from typing import Any

from ...maps.point import Point
from ...maps.register_map import RegisterMap, attribute_names, spelled
from .csv_text import csv_rows
from .map_file import PADDINGS
from .texts import shown_key

__all__ = ["MARK", "class_name", "class_text", "csv_text", "toml_text"]

WORD_OF = {character: word for word, character in PADDINGS.items()}

_DEFAULTS = {each.name: each.default for each in fields(Point) if each.init}


def toml_text(points: Iterable[Point]) -> str:
    """Return points as TOML: a table for each, with the arguments that are not defaults."""
    return "\n".join(
        "\n".join(["[[point]]", *(f"{key} = {_shown(value)}" for key, value in _said(point)), ""])
        for point in points
    )


def csv_text(points: Iterable[Point]) -> str:
    """Return points as CSV: a line for each."""
    said = [dict(_said(point)) for point in points]
    used = [key for key in _DEFAULTS if any(key in keys for keys in said)]
    return csv_rows([used, *([_cell(keys.get(key, "")) for key in used] for keys in said)])


def _cell(value: Any) -> Any:
    """Return a value as the readers of cells take it."""
    if isinstance(value, bool):
        return _shown(value)
    if isinstance(value, str) and value in WORD_OF:
        return WORD_OF[value]
    if isinstance(value, tuple):
        return "; ".join(map(str, value))
    if not isinstance(value, Mapping):
        return value
    if any(set(name) & set(";={") for name in value.values()):
        return json.dumps(value, ensure_ascii=False)
    return "; ".join(f"{key} = {name}" for key, name in value.items())


def _said(point: Point) -> list[tuple[str, Any]]:
    return [
        (key, value)
        for key, default in _DEFAULTS.items()
        if (value := getattr(point, key)) is not None and value != default
    ]


def _shown(value: Any) -> str:
    if isinstance(value, Mapping):
        pairs = (f"{shown_key(str(key))} = {_shown(each)}" for key, each in value.items())
        return f"{{ {', '.join(pairs)} }}"
    # Printable text, numbers and lists are written alike in JSON and TOML.
    return json.dumps(value, ensure_ascii=False)


# --- as a class -----------------------------------------------------------------------------------


MARK = "written by libmodbus-py map class"
"""In the first lines of such a file: only those are overwritten."""

WIDTH = 88

WHOLE = {f"{kind}{bits}" for kind in ("int", "uint", "bcd") for bits in (16, 32, 64)}

# Names that the file itself has, or imports.
USED = {
    *("Any", "AsyncClient", "ClientT", "Context", "Coroutine", "Generic", "Literal", "MAP"),
    *("MapBinding", "Point", "RegisterMap", "Sequence", "TypeVar", "TypedDict", "Unpack"),
}

# Keys of points from which there may be no value.
DOUBTS = ("missing", "plausible_minimum", "plausible_maximum", "scale_from")


def class_text(map: RegisterMap, stem: str) -> str:
    """
    Return the text of a Python file, the same for the same map.

    Args:
        stem: the name of the map's file without its ending, after which the class is named.
    """
    name = class_name(stem)
    if name in USED:
        name += "Map"
    names = attribute_names(map)
    return "\n".join([*_head(map, names, name, stem), *_class(map, names, name)]) + "\n"


def class_name(stem: str) -> str:
    """Return the name of a class for a file without its ending: ``Sdm630V2`` for "sdm630-v2"."""
    words = [each for each in re.split("_+", spelled(stem)) if each]
    text = "".join(word[0].upper() + word[1:] for word in words) or "Meter"
    text = unicodedata.normalize("NFKC", text)
    return text if text.isidentifier() and not keyword.iskeyword(text) else f"Map{text}"


def _head(map: RegisterMap, names: Mapping[str, str], name: str, stem: str) -> Iterator[str]:
    readable = [names[each.name] for each in map.values() if each.is_readable]
    writable = [each for each in map.values() if each.is_writable]
    kinds = {_kind(each) for each in map.values()}
    yield from ('"""', *_docstring(f"The points of {stem}, {MARK}.", ""), '"""', "")
    yield from ("from __future__ import annotations", "")
    lists = [each for each in writable if each.count > 1 or _kind(each).startswith("list")]
    yield f"from collections.abc import Coroutine{', Sequence' if lists else ''}"
    if any("datetime" in kind for kind in kinds):
        yield "from datetime import datetime"
    typing = ["TYPE_CHECKING", "Any", "Generic", "TypedDict", "TypeVar", "Unpack", "overload"]
    typing += ["Literal"] if readable else []
    yield "from typing import ("
    yield from (f"{TAB}{each}," for each in sorted(typing, key=_import_order))
    yield ")"
    yield from ("", "from libmodbus_py import Point, RegisterMap")
    yield from ("from libmodbus_py.bound import MapBinding", "")
    yield from ("if TYPE_CHECKING:", f"{TAB}from libmodbus_py import AsyncClient, Context", "")
    yield from ('ClientT = TypeVar("ClientT", "Context", "AsyncClient")', "")
    yield from _literal_type(f"{name}Name", readable)
    yield from ("", "", f"class {name}Values(TypedDict, total=False):")
    yield f'{TAB}"""Values that can be written."""'
    if writable:
        yield ""
    yield from (f"{TAB}{names[each.name]}: {_written_kind(each)}" for each in writable)
    yield from ("", "", "MAP = RegisterMap(", f"{TAB}[")
    for point in map.values():
        yield from _point(point)
    yield from (f"{TAB}]", ")")
    yield from _requests(name)


def _import_order(name: str) -> tuple[bool, bool, str]:
    """Return the key of a name among others: constants, classes, functions."""
    return not name.isupper(), name[0].islower(), name.lower()


def _class(map: RegisterMap, names: Mapping[str, str], name: str) -> Iterator[str]:
    yield f"class {name}(_{name}Requests[ClientT]):"
    text = "Values of the last read(); each is written with write()."
    yield f'{TAB}"""{text}"""'
    for point in map.values():
        if not point.is_readable:
            continue
        kind = _kind(point)
        is_certain = kind != "datetime" and not any(
            getattr(point, each, None) is not None for each in DOUBTS
        )
        told = kind if is_certain else f"{kind} | None"
        yield from ("", f"{TAB}@property", f"{TAB}def {names[point.name]}(self) -> {told}:")
        yield f'{TAB * 2}"""'
        yield from _docstring(_about(point), TAB * 2)
        yield f'{TAB * 2}"""'
        get = "_certain" if is_certain else "_value"
        yield f"{TAB * 2}value: {told} = self.{get}({_quoted(point.name)})"
        yield f"{TAB * 2}return value"


TAB = "    "

READ = "Read points, all that can be read unless attributes are named."
WRITE = "Write values; all are checked before the first byte is sent."


def _requests(name: str) -> Iterator[str]:
    """Yield the class with the two methods, which is apart: no attribute hides its names."""
    own = f"_{name}Requests"
    yield from ("", "", f"class {own}(MapBinding, Generic[ClientT]):")
    yield f"{TAB}def __init__(self, client: ClientT, **options: Any) -> None:"
    yield f"{TAB * 2}super().__init__(client, MAP, **options)"
    for method, given, type_, text in (
        ("read", "*attributes", f"{name}Name", READ),
        ("write", "**values", f"Unpack[{name}Values]", WRITE),
    ):
        yield ""
        for client, result in (("Context", "None"), ("AsyncClient", "Coroutine[Any, Any, None]")):
            yield f"{TAB}@overload"
            arguments = f"self: {own}[{client}], {given}: {type_}"
            yield from _signature(f"def {method}", arguments, f"{result}: ...")
        yield f"{TAB}def {method}(self, {given}: Any) -> Any:"
        yield f'{TAB * 2}"""{text}"""'
        yield f"{TAB * 2}return self._{method}({given.strip('*')})"
    yield from ("", "")


def _signature(start: str, arguments: str, end: str) -> Iterator[str]:
    line = f"{TAB}{start}({arguments}) -> {end}"
    if len(line) <= WIDTH:
        yield line
    else:
        yield from (f"{TAB}{start}(", f"{TAB * 2}{arguments}", f"{TAB}) -> {end}")


def _literal_type(name: str, words: list[str]) -> Iterator[str]:
    if len(words) < 2:
        yield f"{name} = Literal[{_quoted(words[0])}]" if words else f"{name} = str"
        return
    yield f"{name} = Literal["
    yield from (f"{TAB}{_quoted(word)}," for word in words)
    yield "]"


def _point(point: Point) -> Iterator[str]:
    yield f"{TAB * 2}Point("
    for field in fields(point):
        if not field.init:
            continue
        value = getattr(point, field.name)
        if field.name in ("name", "table", "address") or value != field.default:
            yield f"{TAB * 3}{field.name}={_literal(value)},"
    yield f"{TAB * 2}),"


# --- types ----------------------------------------------------------------------------------


def _kind(point: Point) -> str:
    """Return the type of the value of a point."""
    kind = _kind_of_one(point)
    return f"list[{kind}]" if point.count > 1 else kind


def _written_kind(point: Point) -> str:
    """Return the type of what can be written to a point."""
    kind = _kind_of_one(point)
    kind = kind.replace("list[", "Sequence[")
    return f"Sequence[{kind}]" if point.count > 1 else kind


def _kind_of_one(point: Point) -> str:
    if point.states is not None:
        return "str | int"
    if point.bits is not None:
        return "dict[str, int]"
    if point.read.kind is None or (point.bit is not None and ".." not in str(point.bit)):
        return "bool"
    is_whole = not any(each % 1 for each in (point.scale, point.offset))
    if point.type in WHOLE:
        return "int" if is_whole and point.scale_from is None else "float"
    if str(point.type).startswith("float"):
        return "float"
    if point.read.kind.is_text or point.type == "eui48":
        return "str"
    if str(point.type).startswith("bits"):
        return "list[bool]"
    return "datetime" if point.read.kind.is_time else "Any"


# --- texts ----------------------------------------------------------------------------------


def _about(point: Point) -> str:
    """Return the text about a point: its type, its unit of measurement, and what it is."""
    many = f"{point.count} values of " if point.count > 1 else ""
    facts = [f"{many}{point.type or 'bit'}"]
    facts += [point.units] if point.units else []
    if point.has_bounds:
        low, high = ("" if each is None else each for each in (point.minimum, point.maximum))
        facts.append(f"{low}..{high}")
    facts += ["read-only"] if not point.is_writable else []
    first = f"{point.name}: {', '.join(facts)}."
    return f"{first}\n\n{point.description}" if point.description else first


def _docstring(text: str, indent: str) -> Iterator[str]:
    """Yield the lines of a text inside of a docstring, which it cannot end."""
    for line in text.expandtabs(4).split("\n"):
        safe = "".join(_escaped(each, '"') for each in line.strip())
        if not safe:
            yield ""
            continue
        for part in textwrap.wrap(
            safe, WIDTH - len(indent), break_long_words=False, break_on_hyphens=False
        ):
            yield indent + part


def _quoted(text: str) -> str:
    """Return a text as a literal, in the quotes that a formatter would choose."""
    quote = "'" if text.count('"') > text.count("'") else '"'
    return quote + "".join(_escaped(each, quote) for each in text) + quote


def _escaped(character: str, quote: str) -> str:
    if character in ("\\", quote):
        return f"\\{character}"
    if character.isprintable():
        return character
    return ascii(character)[1:-1]


def _literal(value: Any) -> str:
    """Return a value of a point's field as Python writes it."""
    if isinstance(value, str):
        return _quoted(value)
    if value is None or isinstance(value, bool | int):
        return repr(value)
    if isinstance(value, float) and math.isfinite(value):
        return repr(value)
    if isinstance(value, Mapping):
        items = (f"{_literal(key)}: {_literal(each)}" for key, each in value.items())
        return f"{{{', '.join(items)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_literal, value))}]"
    raise TypeError(f"a point cannot be written with {value!r}")
