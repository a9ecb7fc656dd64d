"""
Points that scale other points: chains of them, and chains that lead nowhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from libmodbus_py import Point
from libmodbus_py.maps.point_plan import scale_mistakes, sources_of

H = "holding_registers"


class Counting(Mapping[str, Point]):
    """Points by name; `looked_up` counts how often one is looked up."""

    def __init__(self, *points: Point) -> None:
        self._points = {each.name: each for each in points}
        self.looked_up = 0

    def __getitem__(self, name: str) -> Point:
        self.looked_up += 1
        return self._points[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._points)

    def __len__(self) -> int:
        return len(self._points)


def chain(count: int, first: str | None = None) -> Counting:
    """Return points of which each is scaled by the one before, and the first by another one."""
    points = [Point("p0", H, 0, scale_from=first)]
    points += [Point(f"p{at}", H, at, scale_from=f"p{at - 1}") for at in range(1, count)]
    return Counting(*points)


def test_a_long_chain_is_followed_once() -> None:
    points = chain(1600)
    assert list(scale_mistakes(points)) == []
    assert points.looked_up <= 4 * 1600
    points.looked_up = 0
    assert len(sources_of(points.values(), points)) == 1599
    assert points.looked_up <= 4 * 1600


def test_each_point_that_leads_back_is_named() -> None:
    mistakes = dict(scale_mistakes(chain(3, first="p1")))
    assert {name: str(each) for name, each in mistakes.items()} == {
        "p0": "p0.scale_from: leads back to a point: p0, p1, p0",
        "p1": "p1.scale_from: leads back to a point: p1, p0, p1",
        "p2": "p2.scale_from: leads back to a point: p2, p1, p0, p1",
    }


def test_only_the_point_beside_a_missing_one_is_wrong() -> None:
    ((name, mistake),) = scale_mistakes(chain(3, first="x"))
    assert (name, str(mistake)) == ("p0", "p0.scale_from: the map has no point 'x'")
