"""
The cells of register lists: a reader for each kind of column, which returns a value of `Point` or
raises WrongValue.
"""

from __future__ import annotations

import contextlib
import json
import re
import reprlib
from collections.abc import Callable, Mapping
from typing import Any

from ..files.csv_text import flag_in, number_in, whole_in
from ..protocol.mistakes import WrongValue, close_to
from ..protocol.values import parse_reference
from ..protocol.words import ORDER_WORDS, TYPE_WORDS, plain, type_named
from .list_words import ListOptions, word_of, words
from .point_checks import BYTES, SCALES

FUNCTION_TABLES = {
    **dict.fromkeys((1, 5, 15), "coils"),
    2: "discrete_inputs",
    **dict.fromkeys((3, 6, 16, 22, 23), "holding_registers"),
    4: "input_registers",
}
"""Function code -> the table that it reads or writes."""

PADDINGS = {"space": " ", "nul": "\0"}
"""Word -> the character that it stands for in the column of paddings."""

_FUNCTION = re.compile(r"(?<![0-9a-z])(?:fc|f|0x)? ?([0-9]{1,2})(?![0-9a-z])")


def _word(meanings: Mapping[str, str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if meaning := meanings.get(word_of(text)):
            return meaning
        allowed = ", ".join(dict.fromkeys(meanings.values()))
        raise WrongValue((), f"must be one of {allowed}, not {reprlib.repr(text)}")

    return read


def _writable(text: str) -> str:
    yes = ["yes", "y", "true", "1", "x", "w", "ja", "oui", "sí", "si", "是"]
    no = ["no", "n", "false", "0", "-", "nein", "non", "否"]
    return _word(dict.fromkeys(yes, "read_write") | dict.fromkeys(no, "read"))(text)


def _function(text: str) -> str:
    """Return the table of "3", "03/06/16", "0x04" or "FC 3"."""
    tables = {FUNCTION_TABLES.get(int(code)) for code in _FUNCTION.findall(text.casefold())}
    if len(tables) != 1 or None in tables:
        allowed = ", ".join(map(str, FUNCTION_TABLES))
        raise WrongValue((), f"must be of {allowed}, all of one table, not {reprlib.repr(text)}")
    return str(*tables)


def _missing(text: str) -> str | list[int | float]:
    """Return the numbers of "65535" or "0x8000; -1", or the word sunspec."""
    if plain(text) == "sunspec":
        return "sunspec"
    numbers = re.split(r"[;,\s]+", text.strip("; "))
    return [whole_in(word) if word[:2] in ("0x", "0X") else number_in(word) for word in numbers]


def _json(text: str, kind: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        raise WrongValue((), f"must be {kind}, not {reprlib.repr(text)}") from None


def _names(text: str) -> dict[str, str]:
    """Return the names of "0 = off; 1 = on", or of a JSON object."""
    if text.startswith("{"):
        return dict(_json(text, "a JSON object"))
    names: dict[str, str] = {}
    for pair in text.strip("; ").split(";"):
        key, separator, name = pair.partition("=")
        if not separator or not name.strip():
            raise WrongValue((), f"must be like 0 = off; 1 = on, not {reprlib.repr(text)}")
        if key.strip() in names:
            raise WrongValue((), f"must name {key.strip()} once, not twice")
        if _STATES.search(name):
            raise WrongValue((), f"must have ; between its names, not {reprlib.repr(text)}")
        names[key.strip()] = name.strip()
    return names


_STATES = re.compile(r"(?<!\S)-?[0-9]+\s*=")


_WITH_SCALE = re.compile(r"[x\xd7*]?\s*([01][.,]0*1|10+|1/10+)\s*(?=[^\W\d]|[°%µ])(.*)")
_SCALE_BEHIND = re.compile(r".*[^\W\d]\s*[x\xd7*]\s*[01][0-9.,]*")


def _units(text: str) -> str:
    if _WITH_SCALE.fullmatch(text) or _SCALE_BEHIND.fullmatch(text):
        reason = f"{reprlib.repr(text)} has a scale: --column scale_and_units=HEADING reads 0.1 V"
        raise WrongValue((), f"{reason}, or write it in a column of its own")
    return text


def _scale_and_units(text: str) -> dict[str, Any]:
    """Return the scale and the units of "0.1 V", or the units of "V"."""
    if match := _WITH_SCALE.fullmatch(text):
        return {"scale": number_in(match[1].replace(",", ".")), "units": match[2]}
    return {"units": _units(text)}


def _exponent(text: str) -> int:
    number = number_in(text)
    if not isinstance(number, int) or not -30 <= number <= 30:
        raise WrongValue((), f"must be a power of ten in -30..30, not {reprlib.repr(text)}")
    return number


_NUMBER = r"([0-9]+(?:[.,][0-9]+)?)"
_FORMULA = re.compile(rf"x\s*([*/])\s*{_NUMBER}")
_POWER = re.compile(r"x\s*\*\s*math\.pow\(\s*10\s*,\s*sf\[['\"]([0-9]+)['\"]\]\s*\)")


def _formula(text: str) -> dict[str, Any]:
    """Return the scale of "x * 0.1", or the address of the power of ten that scales."""
    if factor := _FORMULA.fullmatch(text.strip()):
        number = number_in(factor[2].replace(",", "."))
        return {"scale" if factor[1] == "*" else "divisor": number}
    if power := _POWER.fullmatch(text.strip().casefold()):
        return {"scale_address": power[1]}
    form = "x * 0.1, x / 10 or x * Math.pow(10, sf['40075'])"
    raise WrongValue((), f"must be like {form}, not {reprlib.repr(text)}")


def _initial(text: str) -> Any:
    """Return the number, the truth, the list in JSON, or the text."""
    if text.startswith("["):
        return _json(text, "a list in JSON")
    for read in (flag_in, number_in):
        with contextlib.suppress(WrongValue):
            return read(text)
    return text


NUMBERS = ("scale", "divisor", "offset", "interval", "minimum", "maximum", "plausible_minimum")
RAW = {"raw_minimum": "minimum", "raw_maximum": "maximum", "raw_initial": "initial"}
"""Column with a raw number -> the argument whose number it is, after scaling."""

READERS: dict[str, Callable[[str], Any]] = {
    **dict.fromkeys(("name", "description", "encoding", "scale_from", "bit"), str),
    **dict.fromkeys(("time_zone", "group", "device", "write_function"), str),
    **dict.fromkeys(("address", "address_hex", "address_dec"), str),
    **dict.fromkeys(("count", "registers", "bytes"), whole_in),
    **dict.fromkeys((*NUMBERS, *RAW, "plausible_maximum", "rewrite"), number_in),
    **dict.fromkeys(("states", "bits"), _names),
    "units": _units,
    "units_or_states": lambda text: (
        {"states": _names(text)} if _STATES.match(text) else {"units": _units(text)}
    ),
    "scale_and_units": _scale_and_units,
    "exponent": _exponent,
    "negative_exponent": lambda text: -_exponent(text),
    "formula": _formula,
    "initial": _initial,
    "table": lambda text: _word(words().tables)(text),
    "function": _function,
    "type": str,
    "order": lambda text: ORDER_WORDS.get(plain(text), text),
    "padding": lambda text: PADDINGS.get(plain(text), text),
    "access": lambda text: _word(words().accesses)(text),
    "writable": _writable,
    "missing": _missing,
    **dict.fromkeys(("never_falls", "border"), flag_in),
    "scale_as": _word({word: word for word in SCALES}),
    "byte": _word({word: word for word in BYTES}),
}
"""Kind of a column -> the reader of its cells."""


# --- addresses ---------------------------------------------------------------------------

_RANGE = re.compile(r"(.+?)\s*(?:-|\u2013|~|\.\.+|\bto\b|,|;)\s*(.+)")
_WITH_TABLE = re.compile(r"([134])[x:]0*([1-9][0-9]{0,4})")


def address_in(cell: str, base: int, *, is_reference: bool) -> tuple[str, int, int | None]:
    """Return the table of a cell, or "", its address, and how many it names; None for one."""
    if ends := _RANGE.fullmatch(cell):
        first, last = (address_in(end, base, is_reference=is_reference) for end in ends.groups())
        if last[1] < first[1]:
            raise WrongValue((), f"must rise: {reprlib.repr(cell)}")
        return first[0], first[1], last[1] - first[1] + 1
    if match := _WITH_TABLE.fullmatch(cell.casefold()):
        return *parse_reference(f"{match[1]}{match[2]:0>5}"), None
    if not is_reference:
        return "", _number(cell, base), None
    try:
        return *parse_reference(cell), None
    except ValueError:
        form = "a reference such as 40123 or 300007 where nothing says the table"
        text = f"{reprlib.repr(cell)} (--list table=holding_registers says it)"
        raise WrongValue((), f"must be {form}, not {text}") from None


def _number(cell: str, base: int) -> int:
    if base == 16 and re.fullmatch("[0-9A-Fa-f]{1,8}", cell):
        return int(cell, 16)
    hint = "if it is hexadecimal, say --column address_hex=HEADING"
    if base != 10 and (re.fullmatch("[0-9A-Fa-f]{2,8}", cell) and not cell.isdecimal()):
        raise WrongValue((), f"must be like 100, 0x64 or 64h; {hint}: {reprlib.repr(cell)}")
    if base != 10 and re.fullmatch("0[0-9]+", cell):
        raise WrongValue((), f"may be decimal, --column address_dec=HEADING; {hint}: {cell}")
    return whole_in(cell)


# --- types -------------------------------------------------------------------------------

_WITH_ORDER = re.compile("(.+?) ?(abcd|cdab|badc|dcba|ab|ba)")
_ORDERS = {"ab": "ABCD", "ba": "DCBA"}
_TEXT = re.compile(r"(?:string|str|char|chars|ascii|text|utf8|字符串) ?:? ?([0-9]{1,9})")


def type_keys(
    cell: str, options: ListOptions, registers: int | None, size: int | None
) -> dict[str, Any]:
    """Return the arguments that the word of a type says; `registers` and `size` of a text."""
    origin = options.of_origin
    word = word_of(cell)
    said = {word_of(key): meaning for key, meaning in options.types.items()}
    meaning = said.get(word, origin.types.get(word))
    if meaning is None and re.fullmatch(r"string:[0-9]+", cell.casefold()):
        return {"type": cell.casefold()}
    if meaning is None and (length := _TEXT.fullmatch(word)):
        return {"type": f"string:{_text_size(int(length[1]), cell, options, registers, size)}"}
    if meaning is None:
        meaning = _meaning(word)
    if meaning is None and (parts := _WITH_ORDER.fullmatch(word)):
        order = _ORDERS.get(parts[2], parts[2].upper())
        meaning = f"{_meaning(parts[1])} {order}" if _meaning(parts[1]) else None
    has_size = registers is not None or size is not None
    if meaning is None and has_size and _TEXT.fullmatch(f"{word} 1"):
        meaning = "string"
    if meaning is None:
        raise _unknown(cell, word)
    if meaning.startswith("?"):
        raise WrongValue((), meaning[1:])
    name, _, more = meaning.partition(" ")
    key = "byte" if more in BYTES else "encoding" if more.startswith("utf") else "order"
    keys = {"type": name} | ({key: more} if more else {})
    if name == "string":
        if not has_size:
            raise WrongValue((), f"{cell} needs a column with its registers or bytes")
        keys["type"] = f"string:{2 * registers if registers is not None else size}"
    return keys


def _meaning(word: str) -> str | None:
    return TYPE_WORDS.get(word) or type_named(word) or words().types.get(word)


def _text_size(
    length: int, cell: str, options: ListOptions, registers: int | None, size: int | None
) -> int:
    """Return the bytes of a text of a length, which counts bytes or registers."""
    lengths = options.lengths or options.of_origin.lengths
    if registers is not None and length in (registers, 2 * registers):
        return 2 * registers
    if size is not None and length == size:
        return size
    if lengths is None:
        hint = "say --list lengths=bytes or =registers"
        raise WrongValue((), f"{cell} may count bytes or registers: {hint}")
    return length if lengths == "bytes" else 2 * length


def _unknown(cell: str, word: str) -> WrongValue:
    if meanings := words().ambiguous_types.get(word):
        example = f"--list 'types={cell}={re.split('[, ]', meanings)[0]}'"
        return WrongValue((), f"{cell} may be {meanings}: say which, as in {example}")
    names = ", ".join(dict.fromkeys([*TYPE_WORDS.values(), "string:N"]))
    hint = close_to(word, [*TYPE_WORDS, *words().types])
    text = f"{reprlib.repr(cell)} (--list 'types={cell}=TYPE' says it)"
    return WrongValue((), f"must be one of {names}, not {text}{hint}")
