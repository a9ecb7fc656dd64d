"""
The columns of register lists: which heading means what.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from ..files.csv_text import CsvRow
from ..protocol.mistakes import close_to
from .list_cells import READERS
from .list_words import MOST_NAMED, Origin, word_of, words

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
        ignored = headings.pop(NOTHING, ())
        ignored = [ignored] if isinstance(ignored, str) else ignored
        kinds = words().headings | HEADINGS_OF_KINDS
        headings = {kinds.get(word_of(kind), kind): text for kind, text in headings.items()}
        for kind in headings:
            if kind not in READERS:
                allowed = ", ".join((*READERS, NOTHING))
                hint = close_to(kind, READERS)
                raise ValueError(f"columns must name some of {allowed}, not {kind!r}{hint}")
        return cls(headings, frozenset(map(word_of, ignored)))


def find_columns(
    head: CsvRow, said: SaidColumns, origin: Origin, error: Callable[[str], Exception]
) -> tuple[dict[str, ListColumn], list[str]]:
    """
    Return the columns of a row of headings by their kinds, and the headings that mean nothing;
    raise what `error` makes of a reason if a heading has two meanings, or one is missing.
    """
    cells = [" ".join(cell.split()) for cell in head.cells]
    by_heading = {word_of(heading): kind for kind, heading in said.headings.items()}
    for key, heading in said.headings.items():
        if word_of(heading) not in map(word_of, cells):
            raise error(f"no column {heading}, which is named for {key}")
    columns: dict[str, ListColumn] = {}
    ignored = []
    kind: str | None
    # Headings that are the names of keys come before other words.
    headings = [(at, heading) for at, heading in enumerate(cells) if heading]
    for at, heading in sorted(headings, key=lambda column: word_of(column[1]) not in KEYS):
        word, base = without_base(word_of(heading))
        kind = by_heading.get(word_of(heading)) or _kind(heading, word, said, origin, error)
        if kind is None:
            ignored.append(heading)
            continue
        if kind in ("address_hex", "address_dec"):
            kind, base = "address", 16 if kind.endswith("hex") else 10
        if kind not in columns:
            columns[kind] = ListColumn(at, heading, base)
        elif kind == "address" and base != columns[kind].base and base:
            if base == 10:  # one in hexadecimal beside it says the same
                columns[kind] = ListColumn(at, heading, base)
        elif kind == "description" or (
            word_of(columns[kind].heading) in KEYS and kind not in CHANGE_VALUES
        ):
            ignored.append(heading)
        else:
            both = f"columns {columns[kind].heading} and {heading} both hold the {kind}"
            raise error(f"{both}: say which, as in {_option(kind, heading)}")
    for key in ("name", "address"):
        if key not in columns:
            usual = [word for word, meaning in words().headings.items() if meaning == key]
            some = ", ".join(usual[:MOST_NAMED])
            raise error(f"no column {key}; it may be called {some} ...")
    return columns, ignored


def _kind(
    heading: str, word: str, said: SaidColumns, origin: Origin, error: Callable[[str], Exception]
) -> str | None:
    """Return the kind of a heading that is not named in the options; None if it has none."""
    if word_of(heading) in said.ignored:
        return None
    for text in (word_of(heading), word, word.removeprefix("modbus ")):
        if text in origin.columns:
            return origin.columns[text] or None
        kind = HEADINGS_OF_KINDS.get(text, words().headings.get(text))
        if kind in said.headings:
            return None  # another column is said to hold it
        if kind is not None:
            return kind
    ambiguous = words().ambiguous
    if (key := ambiguous.get(word_of(heading), ambiguous.get(word))) is not None:
        choices = words().choices[key]
        if not choices.keys().isdisjoint(said.headings):
            return None
        meanings = ", or ".join(
            f"{_option(kind, heading)} if {text}" for kind, text in choices.items()
        )
        raise error(f"column {heading} has two meanings: say {meanings}")
    alarming = words().alarming
    spaced = word_of(re.sub("(?<=[a-z])(?=[A-Z])", " ", heading))  # of valueFormat
    parts = [*word.split(), *spaced.split()]
    parts += [part for part in alarming if not part.isascii() and part in word]
    kinds = [alarming[part] for part in parts if part in alarming]
    if kinds and word not in words().harmless and kinds[0] not in said.headings:
        advice = f"{_option(kinds[0], heading)}, or {_option(NOTHING, heading)} to ignore it"
        raise error(f"column {heading} is not known: say {advice}")
    return None


def _option(kind: str, heading: str) -> str:
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
