"""
Points of a file before they are checked; every mistake is collected with its place.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ....maps.point import Point
from ....maps.point_plan import scale_mistakes
from ....protocol.mistakes import Path, WrongValue, placed
from ..file_error import FileError, FilePlace
from ..schema import keys_of

__all__ = ["MAX_POINTS", "POINT", "Contents", "Draft", "MapError", "collected"]

# As many as a file in TOML can have.
MAX_POINTS = 10_000

POINT = keys_of(Point)
"""The keys of a point, in every file that describes points."""


class MapError(FileError):
    """A file is not a valid register map; the message names file, line, column or key."""


class Draft(NamedTuple):
    """
    One point of a file, not yet checked.

    Attributes:
        path: path of the point in the file; empty in CSV, where a row is a point.
        place: returns the place of a path.
        keys: returns the arguments of `Point`; raises a TypeError or ValueError if the file
            contains a mistake.
    """

    path: Path
    place: Callable[[Path], FilePlace]
    keys: Callable[[], Mapping[str, Any]]


@dataclass
class Contents:
    """
    The content of a file.

    Attributes:
        points: all valid points, by name.
        drafts: the draft of each of these points, by name.
        mistakes: all mistakes; the file is not a map if there are any.
        ignored: headings of columns without a known meaning.
    """

    points: dict[str, Point] = field(default_factory=dict)
    drafts: dict[str, Draft] = field(default_factory=dict)
    mistakes: list[MapError] = field(default_factory=list)
    ignored: list[str] = field(default_factory=list)

    def place(self, name: str) -> FilePlace:
        """Return the place of a point in the file."""
        draft = self.drafts[name]
        return draft.place(draft.path)


def collected(contents: Contents, drafts: Iterable[Draft], most: int) -> Contents:
    """Return the points of drafts, up to the mistake with the number `most`."""
    try:
        for draft in drafts:
            _take(contents, draft)
            if len(contents.mistakes) == most:
                return contents
    except MapError as error:
        contents.mistakes.append(error)
    for name, mistake in scale_mistakes(contents.points) if not contents.mistakes else ():
        draft = contents.drafts[name]
        path = (*draft.path, *mistake.path[1:])
        contents.mistakes.append(MapError.of(mistake.renamed(draft.path), draft.place(path)))
    del contents.mistakes[most:]
    if not contents.points and not contents.mistakes:
        contents.mistakes.append(MapError((), "it has no points"))
    return contents


def _take(contents: Contents, draft: Draft) -> None:
    """Add a point, or the mistake in its draft."""
    try:
        point: Point = POINT.read(draft.path, draft.keys())
        if point.name in contents.points:
            reason = f"{point.name!r} stands in {contents.place(point.name)} already"
            raise WrongValue((*draft.path, "name"), reason)
    except (TypeError, ValueError) as error:
        mistake = placed(error, ())
        contents.mistakes.append(MapError.of(mistake, draft.place(mistake.path)))
    else:
        contents.points[point.name] = point
        contents.drafts[point.name] = draft
