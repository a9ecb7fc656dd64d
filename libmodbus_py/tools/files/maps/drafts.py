"""
What a file says of a point, before it is one; every mistake is told with its place.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

from ....maps.point import Point

__all__ = ["KEYS", "MAX_POINTS", "Contents", "Draft", "MapError", "Mistake", "collected"]

# As many as a file in TOML can have.
MAX_POINTS = 10_000

KEYS = [each.name for each in fields(Point) if each.init]


class MapError(ValueError):
    """A register map that is none: it says file, line, column or key, and what is allowed."""


class Mistake(NamedTuple):
    """
    What is wrong in a file.

    Attributes:
        place: such as "line 7, column Address"; empty for the file as a whole.
        message: what is wrong, and what is allowed.
    """

    place: str
    message: str

    def of(self, path: str) -> str:
        """All of it in one line."""
        return f"{path}{', ' if self.place else ''}{self.place}: {self.message}"


class Draft(NamedTuple):
    """
    What a file says of one point.

    Attributes:
        keys: arguments of `Point`, as far as they are there.
        place: key -> where that stands, such as "line 7, column Address"; of None where the
            point does.
    """

    keys: dict[str, Any]
    place: Callable[[str | None], str]


@dataclass
class Contents:
    """
    What a file holds.

    Attributes:
        points: all that are right, by name.
        places: name of a point -> what gives its place.
        mistakes: the file is no map if there are any.
        ignored: headings of columns that mean nothing here.
    """

    points: dict[str, Point] = field(default_factory=dict)
    places: dict[str, Callable[[None], str]] = field(default_factory=dict)
    mistakes: list[Mistake] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)


def collected(drafts: Iterable[Draft | Mistake], most: int) -> Contents:
    """Make points of drafts, up to the mistake with the number `most`."""
    contents = Contents()
    for draft in drafts:
        found = draft if isinstance(draft, Mistake) else _taken(contents, draft)
        contents.mistakes += [found] if found else []
        if len(contents.mistakes) == most:
            break
    if not contents.points and not contents.mistakes:
        contents.mistakes.append(Mistake("", "it has no points"))
    return contents


def _taken(contents: Contents, draft: Draft) -> Mistake | None:
    """Take a point, unless something is wrong with it."""
    for key in ("name", "table", "address"):
        if key not in draft.keys:
            return Mistake(draft.place(None), f"{key} is missing")
    try:
        point = Point(**draft.keys)
    except (TypeError, ValueError) as error:
        key = re.match(r"\w*", str(error))[0]  # type: ignore[index]
        return Mistake(draft.place(key if key in KEYS else None), str(error))
    if point.name in contents.points:
        first = contents.places[point.name](None)
        return Mistake(draft.place("name"), f"name {point.name!r} stands in {first} already")
    contents.points[point.name] = point
    contents.places[point.name] = draft.place
    return None
