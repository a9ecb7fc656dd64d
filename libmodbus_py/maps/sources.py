"""
Points that scale other points of their map: which they are, and mistakes about them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from ..protocol.mistakes import WrongValue
from .point import Point

__all__ = ["scale_mistakes", "sources_of"]


def scale_mistakes(points: Mapping[str, Point]) -> Iterator[tuple[str, WrongValue]]:
    """Yield the name of each point whose `scale_from` is wrong, and the error."""
    ending: set[str] = set()  # those whose chain of sources is known to end
    for name, point in points.items():
        if point.scale_from is None:
            continue
        if reason := _unfit(points, point.scale_from) or _circle(points, point, ending):
            yield name, WrongValue.about((name, "scale_from"), reason)


def _unfit(points: Mapping[str, Point], name: str) -> str:
    source = points.get(name)
    if source is None:
        return f"the map has no point {name!r}"
    if not source.meaning.has_numbers or source.count > 1:
        return f"{source.name!r} must be one number"
    if not source.is_readable:
        return f"{source.name!r} cannot be read: its access is write"
    return ""


def _circle(points: Mapping[str, Point], point: Point, ending: set[str]) -> str:
    """Return why the chain of sources of a point has no end; if it has, add it to `ending`."""
    chain = {point.name: None}
    source: Point | None = point
    while source is not None and (name := source.scale_from) is not None and name not in ending:
        if name in chain:
            return f"leads back to a point: {', '.join((*chain, name))}"
        chain[name] = None
        source = points.get(name)
    ending.update(chain)
    return ""


def sources_of(points: Iterable[Point], known: Mapping[str, Point]) -> dict[str, Point]:
    """Return the points that scale some points, by name; each before those that it scales."""
    found: dict[str, Point] = {}
    for point in points:
        chain = []
        while (name := point.scale_from) is not None and name not in found:
            point = known[name]
            chain.append(point)
        found |= {each.name: each for each in reversed(chain)}
    return found
