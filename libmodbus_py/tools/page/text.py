"""Values and names as the text of a cell."""

from __future__ import annotations

import re
import reprlib
from collections.abc import Sequence
from typing import Any

from ...maps.point import Point
from ...protocol.plain import text_of

MOST_TEXT = 200  # characters of a cell
MOST_NAMES = 3  # names of what has a problem
MOST_VALUES = 20  # items of a list that a cell shows
LONGEST = 12  # characters of a number that is shown to the last digit


def cell_text(text: object) -> str:
    """Return a text for a cell: cut, and without characters that cannot be printed."""
    whole = text if isinstance(text, str) else str(text)
    start = whole[:MOST_TEXT]
    plain = start if start.isprintable() else "".join(x if x.isprintable() else "?" for x in start)
    return plain if len(whole) <= MOST_TEXT else f"{plain}..."


def first_names(names: Sequence[str]) -> str:
    """Return the first names in brackets, behind what they have in common."""
    more = ", ..." if len(names) > MOST_NAMES else ""
    return cell_text(f" ({', '.join(names[:MOST_NAMES])}{more})")


def in_words(name: str) -> str:
    """Return the name of a class as words: "IllegalDataAddress" is "illegal data address"."""
    return re.sub("(?<=[a-z])(?=[A-Z])", " ", name).lower()


def value_text(value: Any) -> str:
    """Return a value as text, of at most about `MOST_TEXT` characters."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, float):
        # A longer number was decoded from 32 bits, which hold only seven exact digits.
        return text if len(text := repr(value)) <= LONGEST else f"{value:.7g}"
    if isinstance(value, list | tuple):
        more = ", ..." if len(value) > MOST_VALUES else ""
        items = ("-" if item is None else value_text(item) for item in value[:MOST_VALUES])
        return cell_text(", ".join(items) + more)
    if isinstance(value, dict):
        return cell_text(" ".join(f"{name}={value_text(item)}" for name, item in value.items()))
    return cell_text(value if isinstance(value, int | str) else reprlib.repr(value))


def point_text(point: Point, cells: list[Any], source: Any) -> tuple[Any, str]:
    """Return the value of a point, or None if it has none, and its text or the reason."""
    try:
        value, _, reason = point.judge(cells, source=source)
    except (TypeError, ValueError) as error:
        return None, "no such cells" if not cells else f"? {error}"
    if value is None:
        return None, f"- ({reason})"
    values = value if point.count > 1 else [value]
    return value, cell_text(", ".join(_text_of(point, item) for item in values[:MOST_TEXT]))


def _text_of(point: Point, value: Any) -> str:
    kind = point.read.kind
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, str):
        return value if value.isprintable() else reprlib.repr(value)
    if isinstance(value, dict):
        return " ".join(f"{name}={int(bit)}" for name, bit in value.items())
    is_plain = not point.is_part and (point.scale, point.offset, point.scale_from) == (1, 0, None)
    return text_of(value, kind) if is_plain and kind is not None else str(value)
