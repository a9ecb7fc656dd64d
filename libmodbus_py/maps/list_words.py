"""
The words of register lists, from ``list_words.toml``, those of types, and the options that say how
a list is read.

What a word means is looked up in this order: what the options say, what the origin of the list
means by it, what every vendor means.
"""

from __future__ import annotations

import re
import reprlib
import tomllib
import unicodedata
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path as FilePath
from typing import Any, TypedDict

from ..files.csv_text import CsvRow
from ..files.schema import keys_of
from ..protocol.checks import integer
from ..protocol.mistakes import WrongType, WrongValue, close_to, inside, named_arguments
from ..protocol.pdu.request import store
from ..protocol.values import value_type
from ..protocol.words import ORDER_WORDS, TABLE_WORDS, TYPE_WORDS, plain, type_named
from .point_checks import ACCESSES, BYTES

REFERENCE = "reference"
"""In place of a first address: each address is a reference, such as 40123."""

MOST_NAMED = 12
"""How many of a list are named in a message, at most."""


class ListKeys(TypedDict, total=False):
    """The options of `ListOptions` but for its columns, as keyword arguments."""

    origin: str
    encoding: str
    sheet: str
    only: Mapping[str, str]
    types: Mapping[str, str]
    first_address: int | str
    table: str
    access: str
    order: str
    lengths: str


@dataclass(frozen=True)
class Origin:
    """The meanings of words in the lists of an origin; ``list_words.toml`` explains each."""

    about: str = ""
    signs: tuple[str, ...] = ()
    known_by: tuple[str, ...] = ()
    columns: Mapping[str, str] = field(default_factory=dict)
    headings: Mapping[int, list[str]] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)
    accesses: Mapping[str, str] = field(default_factory=dict)
    first_address: int | str | None = None
    table: str | None = None
    order: str | None = None
    lengths: str | None = None
    missing: str | None = None
    is_sloppy: bool = False


def word_of(text: str) -> str:
    """Return a heading or a word of a cell as a key of the tables: "Data_Type " is "data type"."""
    return plain(unicodedata.normalize("NFKC", text))


class ListWords:
    """The tables of ``list_words.toml``, each from word to meaning."""

    def __init__(self, content: Mapping[str, Any]) -> None:
        self.headings: dict[str, str] = {
            word: kind
            for kind, languages in content["headings"].items()
            for text in (kind, *languages.values())
            for word in _split(text)
        }
        # As in camel case: dataType.
        self.headings |= {
            word.replace(" ", ""): kind for word, kind in self.headings.items() if word.isascii()
        }
        self.ambiguous: Mapping[str, str] = _by_word(content["ambiguous"])
        self.choices: Mapping[str, Mapping[str, str]] = content["choices"]
        self.alarming: Mapping[str, str] = _by_word(content["alarming"])
        self.harmless: frozenset[str] = frozenset(_split(content["harmless"]["words"]))
        self.numbered: frozenset[str] = frozenset(_split(content["numbered"]["words"]))
        self.tables: Mapping[str, str] = TABLE_WORDS | _by_word(content["tables"])
        self.accesses: Mapping[str, str] = _by_word(content["accesses"])
        self.types: Mapping[str, str] = _by_word(content["types"])
        self.ambiguous_types: Mapping[str, str] = _by_word(content["ambiguous_types"])
        self.origins: Mapping[str, Origin] = {
            name: Origin(**{key: _keyed(value) for key, value in keys.items()})
            for name, keys in content["origins"].items()
        }


def _split(text: str) -> list[str]:
    return [word_of(word) for word in text.split(",") if word.strip()]


def _by_word(meanings: Mapping[str, str]) -> dict[str, str]:
    return {word: meaning for meaning, text in meanings.items() for word in _split(text)}


def _keyed(value: Any) -> Any:
    """Return a table with its keys as words, or as numbers of columns; other values as they are."""
    if not isinstance(value, Mapping):
        return value
    return {
        int(key) if isinstance(text, list) else word_of(key): text for key, text in value.items()
    }


@cache
def words() -> ListWords:
    """Return the words of register lists, which are read once."""
    text = FilePath(__file__).with_suffix(".toml").read_text(encoding="utf-8")
    return ListWords(tomllib.loads(text))


@named_arguments
@dataclass(frozen=True)
class ListOptions:
    """
    The options of reading a list that does not say all, or means its words in its own way.

    Args:
        columns: kind of a column -> its heading, such as ``{"name": "Bezeichnung"}``. The kind
            "nothing" may have several headings, in a list: those that are ignored.
        origin: whose list it is: "iobroker", "modpoll", "nibe" or "victron".
        encoding: the encoding of the text; UTF-8, or UTF-16 with a mark, unless it is given.
        sheet: the name of the sheet of a spreadsheet; the first one unless it is given.
        only: heading -> the cell of the rows that are read, such as ``{"deviceId": "200"}``.
        types: word of a type -> the type that it means here, such as ``{"long": "int32"}``; an
            order may follow, as in "float32 CDAB".
        first_address: what the list calls address 0, such as 1; or "reference".
        table: the table of all points, if no column says it.
        access: the access of all points, if no column says it.
        order: the order of all points, if no column says it.
        lengths: what the 8 of ``string[8]`` counts: "bytes" or "registers".

    Raises:
        TypeError, ValueError: an argument is none of these; the message begins with its name.
    """

    columns: Mapping[str, Any] = field(default_factory=dict)
    origin: str | None = None
    encoding: str | None = None
    sheet: str | None = None
    only: Mapping[str, str] = field(default_factory=dict)
    types: Mapping[str, str] = field(default_factory=dict)
    first_address: int | str | None = None
    table: str | None = None
    access: str | None = None
    order: str | None = None
    lengths: str | None = None

    def __post_init__(self) -> None:
        for name in ("columns", "only", "types"):
            if not isinstance(getattr(self, name), Mapping):
                raise WrongType(name, f"must be a mapping, not {getattr(self, name)!r}")
        lengths = ("bytes", "registers")
        choices = {"origin": words().origins, "lengths": lengths, "access": ACCESSES}
        for name, values in choices.items():
            value = getattr(self, name)
            if value is not None and value not in values:
                reason = f"must be one of {', '.join(values)}, not {value!r}"
                raise WrongValue(name, reason + close_to(value, values))
        for name, meanings in (("table", TABLE_WORDS), ("order", ORDER_WORDS)):
            if (value := getattr(self, name)) is None:
                continue
            if (meaning := meanings.get(plain(str(value)))) is None:
                values = ", ".join(dict.fromkeys(meanings.values()))
                raise WrongValue(name, f"must be one of {values}, not {value!r}")
            store(self, **{name: meaning})
        if self.first_address not in (None, REFERENCE):
            if isinstance(self.first_address, str) and self.first_address.isdecimal():
                store(self, first_address=int(self.first_address))
            integer("first_address", self.first_address, 0, 0xFFFF * 10)

    def with_origin_of(self, headings: Iterable[str]) -> ListOptions:
        """Return the options with the origin of lists that have such headings, if one has."""
        cells = {word_of(heading) for heading in headings}
        for name, origin in words().origins.items():
            if any(cells.issuperset(_split(text)) for text in origin.known_by):
                return replace(self, origin=name)
        return self

    @property
    def of_origin(self) -> Origin:
        """The meanings of words in lists of its origin."""
        return Origin() if self.origin is None else words().origins[self.origin]

    @property
    def is_empty(self) -> bool:
        """True without any option."""
        return self == ListOptions()


LIST = keys_of(ListOptions).but("columns")
"""The options but for `columns`, as keys of files."""


def options_of(content: Mapping[str, Any]) -> ListOptions:
    """Return the options that the keys `columns` and `list` of a table in a file say."""
    with inside("list"):
        return ListOptions(columns=content.get("columns", {}), **content.get("list", {}))


# --- types -------------------------------------------------------------------------------

# The codes of Python's struct, in which capitals differ.
_CODES = {
    ">h": "int16", ">H": "uint16", ">i": "int32", ">I": "uint32", ">l": "int32", ">L": "uint32",
    ">q": "int64", ">Q": "uint64", ">f": "float32", ">d": "float64",
}  # fmt: skip
_WITH_ORDER = re.compile("(.+?) ?(abcd|cdab|badc|dcba|ab|ba)")
_ORDERS = {"ab": "ABCD", "ba": "DCBA"}
_TEXT = re.compile(r"(?:string|str|char|chars|ascii|text|utf8|字符串) ?:? ?([0-9]{1,9})")


def type_keys(
    cell: str, options: ListOptions, registers: int | None, size: int | None
) -> dict[str, Any]:
    """Return the arguments that the word of a type says; `registers` and `size` of a text."""
    origin = options.of_origin
    word = word_of(cell)
    meanings = {word_of(key): meaning for key, meaning in options.types.items()}
    meaning = meanings.get(word, origin.types.get(word))
    if meaning is None and re.fullmatch(r"string:[0-9]+", cell.casefold()):
        return {"type": cell.casefold()}
    if meaning is None and (length := _TEXT.fullmatch(word)):
        return {"type": f"string:{_text_size(int(length[1]), cell, options, registers, size)}"}
    if meaning is None:
        meaning = _meaning(cell)
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


def _meaning(cell: str) -> str | None:
    word = word_of(cell)
    meaning = TYPE_WORDS.get(word) or type_named(word) or words().types.get(word)
    return meaning or _CODES.get(cell)


def width_of(cell: str) -> int | None:
    """Return the registers of a value of a type; None if its word has not one meaning."""
    meaning = _meaning(cell)
    return None if meaning is None else value_type(meaning.split()[0]).registers


_POWERS = re.compile("1|0[.,]0*1|10{1,4}|1/10{1,4}")


def kind_of_cells(cells: set[str]) -> str | None:
    """Return the kind of a column whose cells are all words of it; None if they are not."""
    texts = [word_of(cell) for cell in cells]
    kinds: dict[str, Iterable[object]] = {
        "table": map(words().tables.get, texts),
        "type": map(_meaning, cells),
        "access": map(words().accesses.get, texts),
        "order": map(ORDER_WORDS.get, texts),
        "scale": map(_POWERS.fullmatch, cells),
    }
    has_meaning = cells and cells != {"1"}
    return next((kind for kind, meanings in kinds.items() if has_meaning and all(meanings)), None)


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


# --- configurations of modpoll in Python, whose rows are of three kinds ---------------------------

MODPOLL = ["device", "table", "order", "name", "address", "type", "access", "units", "scale"]
"""The cells of the rows that `flat_rows` returns."""

# The order of bytes in a register, then that of registers.
ORDERS = {"BE_BE": "ABCD", "BE_LE": "CDAB", "LE_BE": "BADC", "LE_LE": "DCBA"}


def flat_rows(rows: Iterable[CsvRow]) -> Iterator[CsvRow]:
    """
    Yield a row with all that is said of it for each point of modpoll. An older form names the
    device in each poll::

        device,NAME,UNIT                    poll,DEVICE,UNIT,START,SIZE,TABLE,ORDER
        poll,TABLE,START,SIZE,ORDER         ref,NAME,UNITS,ADDRESS,TYPE,ACCESS,SCALE
        ref,NAME,ADDRESS,TYPE,ACCESS,UNITS,SCALE
    """
    device = table = order = ""
    is_old = False
    for line, cells in rows:
        cells = [*cells, *[""] * 7]
        kind = cells[0].casefold()
        if "device" in kind:
            device = cells[1]
        elif "poll" in kind:
            is_old = word_of(cells[1]) not in words().tables
            if is_old:
                device, table, order = cells[1], cells[5], cells[6]
            else:
                table, order = cells[1], cells[4]
        elif "ref" in kind:
            if is_old:
                _, name, units, address, type_, access, scale = cells[:7]
            else:
                _, name, address, type_, access, units, scale = cells[:7]
            order = ORDERS.get(order.upper(), order)
            yield CsvRow(
                line, [device, table, order, name, address, type_, access or "r", units, scale]
            )
