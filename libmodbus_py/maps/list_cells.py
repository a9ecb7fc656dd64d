"""
The columns of register lists: which heading means what; and a reader of the cells of each kind,
which returns a value of `Point` or raises WrongValue.
"""

from __future__ import annotations

import contextlib
import json
import re
import reprlib
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ..files.csv_text import CsvRow, flag_in, number_in, whole_in
from ..protocol.mistakes import WrongValue, close_to
from ..protocol.values import parse_reference
from ..protocol.words import ORDER_WORDS, plain
from .list_words import MOST_NAMED, Origin, word_of, words
from .point_checks import BYTES, SCALES

FUNCTION_TABLES = {
    **dict.fromkeys((1, 5, 15), "coils"),
    2: "discrete_inputs",
    **dict.fromkeys((3, 6, 16, 22, 23), "holding_registers"),
    4: "input_registers",
}
"""Function code -> the table that it reads or writes."""

BLANKS = frozenset(("-", "\u2013", "\u2014", "/", "n/a", "N/A", "none"))
"""Cells that say nothing, but in some columns."""

PADDINGS = {"space": " ", "nul": "\0"}
"""Word -> the character that it stands for in the column of paddings."""

_FUNCTION = re.compile(r"(?<![0-9a-z])(?:fc|f|0x)? ?([0-9]{1,2})(?![0-9a-z])")


def _word(meanings: Mapping[str, str]) -> Callable[[str], str]:
    def read(text: str) -> str:
        if meaning := meanings.get(word_of(text)):
            return meaning
        choices = ", ".join(dict.fromkeys(meanings.values()))
        raise WrongValue((), f"must be one of {choices}, not {reprlib.repr(text)}")

    return read


def _writable(text: str) -> str:
    yes = ["yes", "y", "true", "1", "x", "w", "ja", "oui", "sí", "si", "是"]
    no = ["no", "n", "false", "0", "-", "nein", "non", "否"]
    answers = dict.fromkeys(yes, "read_write") | dict.fromkeys(no, "read")
    return _word({**words().accesses, **answers})(text)


def _function(text: str) -> str:
    """Return the table of "3", "03/06/16", "0x04" or "FC 3"."""
    if table := words().tables.get(word_of(text).removeprefix("read ")):
        return table
    tables = {FUNCTION_TABLES.get(int(code)) for code in _FUNCTION.findall(text.casefold())}
    if len(tables) != 1 or None in tables:
        choices = ", ".join(map(str, FUNCTION_TABLES))
        raise WrongValue((), f"must be of {choices}, all of one table, not {reprlib.repr(text)}")
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
    between = ";" if ";" in text else _BETWEEN_STATES
    for pair in re.split(between, text.strip("; ")):
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
_BETWEEN_STATES = r",(?=\s*-?[0-9]+\s*=)"


# "0.1 V", "x10 (A)" and "0.01", but not "1/min".
_SCALE = r"[0-9]+[.,][0-9]+|10+|1/10+|10\^-?[0-9]+|[0-9]+e-?[0-9]+"
_WITH_SCALE = re.compile(rf"[x\xd7*]?\s*({_SCALE})\s*(?![0-9.,/^])\(?([^()]*)\)?", re.I)
_SCALE_BEHIND = re.compile(rf"(.*[^\s0-9(])\s*\(?([x\xd7*\xf7/])\s*({_SCALE})\)?", re.I)


def _units(text: str) -> str:
    if _WITH_SCALE.fullmatch(text) or _SCALE_BEHIND.fullmatch(text):
        reason = f"{reprlib.repr(text)} has a scale: --column scale_and_units=HEADING reads 0.1 V"
        raise WrongValue((), f"{reason}, or write it in a column of its own")
    return text


def _scale_and_units(text: str) -> dict[str, Any]:
    """Return the scale and the units of "0.1 V", or the units of "V"."""
    if match := _WITH_SCALE.fullmatch(text):
        number, units, is_divisor = match[1], match[2].strip(), False
    elif match := _SCALE_BEHIND.fullmatch(text):
        units, number, is_divisor = match[1], match[3], match[2] in "\xf7/"
    else:
        return {"units": _units(text)}
    base, _, power = number.casefold().replace(",", ".").partition("^")
    scale = number_in(f"1e{power}" if power else base)
    return {"scale": 1 / scale if is_divisor else scale, "units": units or None}


def factor_in(text: str) -> int | float:
    """Return the number of "0.1" or "x 0.1", and the inverse of that of "\xf7 10"."""
    match = re.fullmatch(r"([x\xd7*\xf7:/])\s*(.*)", text, re.IGNORECASE)
    if match is None:
        return number_in(text)
    number = number_in(match[2])
    return number if match[1] in "xX\xd7*" else number_in(f"1/{match[2]}")


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
    "scale": factor_in,
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
_TWO_BASES = re.compile(r"(0x[0-9A-Fa-f]+)\s*\(([0-9]+)\)")  # 0xF300 (62208)
_WITH_TABLE = re.compile(r"([134])[x:]0*([1-9][0-9]{0,4})")


def address_in(cell: str, base: int, *, is_reference: bool) -> tuple[str, int, int | None]:
    """Return the table of a cell, or "", its address, and how many it names; None for one."""
    if ends := _RANGE.fullmatch(cell):
        first, last = (address_in(end, base, is_reference=is_reference) for end in ends.groups())
        if last[1] < first[1]:
            raise WrongValue((), f"must rise: {reprlib.repr(cell)}")
        return first[0], first[1], last[1] - first[1] + 1
    if (pair := _TWO_BASES.fullmatch(cell)) and int(pair[1], 16) == int(pair[2]):
        cell = pair[2]
    if match := _WITH_TABLE.fullmatch(cell.casefold()):
        table, address = parse_reference(f"{match[1]}{match[2]:0>5}")
        return table, address, None
    if not is_reference:
        return "", _number(cell, base), None
    try:
        table, address = parse_reference(cell)
        return table, address, None
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


# --- columns -----------------------------------------------------------------------------

NOTHING = "nothing"
"""The kind of columns that are ignored."""

CHANGE_VALUES = ("type", "order", "scale", "divisor", "units", "access")
"""Kinds of which no second column is ignored."""

HEADINGS_OF_KINDS = {word_of(kind): kind for kind in READERS}
"""Headings that are kinds themselves: all but "device" are keys of a map."""

KEYS = {word for word in HEADINGS_OF_KINDS if word != "device"}


class ListColumn(NamedTuple):
    """A column that says something: where it is, its heading, and the base of its addresses."""

    at: int
    heading: str
    base: int = 0  # 10 or 16, or 0 if the heading does not say it


class SaidColumns(NamedTuple):
    """What the options say of columns: kind -> its heading, and the words that mean nothing."""

    headings: Mapping[str, str]
    ignored: frozenset[str]

    @classmethod
    def of(cls, columns: Mapping[str, Any]) -> SaidColumns:
        """Return what the option `columns` says; raise ValueError if a kind does not exist."""
        headings = {**columns}
        ignored_headings = headings.pop(NOTHING, ())
        ignored_headings = (
            [ignored_headings] if isinstance(ignored_headings, str) else ignored_headings
        )
        kinds = words().headings | HEADINGS_OF_KINDS
        headings = {kinds.get(word_of(kind), kind): text for kind, text in headings.items()}
        for kind in headings:
            if kind not in READERS:
                choices = ", ".join((*READERS, NOTHING))
                hint = close_to(kind, READERS)
                raise ValueError(f"columns must name some of {choices}, not {kind!r}{hint}")
        return cls(headings, frozenset(map(word_of, ignored_headings)))


def find_columns(
    head: CsvRow, option: SaidColumns, origin: Origin, error: Callable[[str], Exception]
) -> tuple[dict[str, ListColumn], list[str]]:
    """
    Return the columns of a row of headings by their kinds, and the headings that mean nothing;
    raise what `error` makes of a reason if a heading has two meanings, or one is missing.
    """
    cells = [" ".join(cell.split()) for cell in head.cells]
    by_heading = {word_of(heading): kind for kind, heading in option.headings.items()}
    for key, heading in option.headings.items():
        if word_of(heading) not in map(word_of, cells):
            raise error(f"no column {heading}, which is named for {key}")
    columns: dict[str, ListColumn] = {}
    ignored_headings = []
    kind: str | None
    # Headings that are the names of keys come before other words.
    headings = [(at, heading) for at, heading in enumerate(cells) if heading]
    for at, heading in sorted(headings, key=lambda column: word_of(column[1]) not in KEYS):
        word, base = without_base(word_of(heading))
        kind = by_heading.get(word_of(heading)) or _kind(heading, word, option, origin, error)
        if kind is None:
            ignored_headings.append(heading)
            continue
        if kind in ("address_hex", "address_dec"):
            kind, base = "address", 16 if kind.endswith("hex") else 10
        if kind not in columns:
            columns[kind] = ListColumn(at, heading, base)
        elif kind == "address" and base != columns[kind].base and base:
            if base == 10:  # a hexadecimal column beside it has the same value
                columns[kind] = ListColumn(at, heading, base)
        elif kind == "description" or (
            word_of(columns[kind].heading) in KEYS and kind not in CHANGE_VALUES
        ):
            ignored_headings.append(heading)
        else:
            both = f"columns {columns[kind].heading} and {heading} both hold the {kind}"
            raise error(f"{both}: say which, as in {option_for(kind, heading)}")
    for key in ("name", "address"):
        if key not in columns:
            usual = [word for word, meaning in words().headings.items() if meaning == key]
            some = ", ".join(usual[:MOST_NAMED])
            advice = f"--column {key}=HEADING says which it is"
            raise error(f"no column {key}; it may be called {some} ...; {advice}")
    return columns, ignored_headings


def _kind(
    heading: str, word: str, option: SaidColumns, origin: Origin, error: Callable[[str], Exception]
) -> str | None:
    """Return the kind of a heading without an option; None for an unknown one."""
    if word_of(heading) in option.ignored:
        return None
    for text in (word_of(heading), word, word.removeprefix("modbus ")):
        if text in origin.columns:
            return origin.columns[text] or None
        kind = HEADINGS_OF_KINDS.get(text, words().headings.get(text))
        if kind is not None and kind.split("_hex")[0].split("_dec")[0] in option.headings:
            return None  # an option names another column for this kind
        if kind is not None:
            return kind
    ambiguous = words().ambiguous
    if (key := ambiguous.get(word_of(heading), ambiguous.get(word))) is not None:
        choices = words().choices[key]
        if not choices.keys().isdisjoint(option.headings):
            return None
        meanings = ", or ".join(
            f"{option_for(kind, heading)} if {text}" for kind, text in choices.items()
        )
        raise error(f"column {heading} has two meanings: say {meanings}")
    kinds_of_parts = words().alarming
    words_of_heading = word_of(re.sub("(?<=[a-z])(?=[A-Z])", " ", heading))  # of valueFormat
    parts = [*word.split(), *words_of_heading.split()]
    parts += [part for part in kinds_of_parts if not part.isascii() and part in word]
    kinds = [kinds_of_parts[part] for part in parts if part in kinds_of_parts]
    if kinds and word not in words().harmless and kinds[0] not in option.headings:
        advice = f"{option_for(kinds[0], heading)}, or {option_for(NOTHING, heading)} to ignore it"
        raise error(f"column {heading} is not known: say {advice}")
    return None


def option_for(kind: str, heading: str) -> str:
    """Return the option that says what a heading means."""
    return f"--column {kind}={heading}" if " " not in heading else f"--column '{kind}={heading}'"


def without_base(word: str) -> tuple[str, int]:
    """Return a heading without the base of its numbers, which is 0 if it does not say it."""
    for ends, base in ((_HEX, 16), (_DEC, 10)):
        for end in ends:
            if word.endswith(end) and word != end.strip():
                return word.removesuffix(end).strip(), base
            if word.startswith(f"{end.strip()} "):
                return word.removeprefix(f"{end.strip()} "), base
    return word, 0


_HEX = (" hex", " hexadecimal", " 0x", "十六进制", " hexadezimal")
_DEC = (" dec", " decimal", "十进制", " dezimal", " décimal")
