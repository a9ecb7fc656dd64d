"""
The points of a device by name: the requests that read them, and the values of the answers.
"""

from __future__ import annotations

import reprlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Unpack

from ..protocol import pdu
from ..protocol.close_names import close_to
from ..protocol.mistakes import WrongType, WrongValue
from .plan import PlanOptions
from .point import Point
from .point_plan import PointPlan

if TYPE_CHECKING:
    from .bound_map import BoundMap, MapClient

__all__ = ["RegisterMap", "close_to", "scale_mistakes", "sources_of"]


class RegisterMap(Mapping[str, Point]):
    """
    The points of one kind of device: an immutable, ordered mapping from names to `Point`.

    ``plc.read_map(map)`` and ``plc.write_map(map, values)`` of the clients use it, and
    `load_map` reads it from a file. Points may overlap, for example two views of one register.

    Args:
        points: the points, with unique names, and with all points that `scale_from` names.

    Raises:
        TypeError, ValueError: an argument is not a Point, a name occurs twice, or `scale_from`
            does not name a readable number of the map, or leads back to its own point.
    """

    __slots__ = ("_kept", "_points")

    def __init__(self, points: Iterable[Point]) -> None:
        self._points: dict[str, Point] = {}
        self._kept: tuple[object, PointPlan] | None = None
        for point in points:
            if not isinstance(point, Point):
                raise WrongType("points", f"must be Point objects, not {type(point).__name__}")
            if point.name in self._points:
                raise WrongValue("name", f"{point.name!r} occurs twice")
            self._points[point.name] = point
        for _, mistake in scale_mistakes(self._points):
            raise mistake

    def __getitem__(self, name: str) -> Point:
        return self._points[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._points)

    def __len__(self) -> int:
        return len(self._points)

    def __repr__(self) -> str:
        return f"<RegisterMap of {len(self)} points: {reprlib.repr(list(self))}>"

    def plan(self, names: Iterable[str] | None = None, **options: Unpack[PlanOptions]) -> PointPlan:
        """
        Return the plan that reads points; the plan made last is cached.

        Args:
            names: names of points, in the order of the results; None for all readable points.
            options: the options of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be read; or as for `Plan`.
        """
        wanted = None if names is None else tuple(_checked_names(names))
        asked = (wanted, options)
        if (kept := self._kept) is not None and kept[0] == asked:
            return kept[1]
        points = self._readable(wanted)
        made = PointPlan(points, sources_of(points, self._points), **options)
        # The caller may change the list of forbidden ranges later.
        if "forbidden" not in options:
            self._kept = (asked, made)
        return made

    def writes(
        self,
        values: Mapping[str, Any],
        *,
        multiple: bool = False,
        sources: Mapping[str, Any] | None = None,
    ) -> list[pdu.Request[None]]:
        """
        Return the requests that write values to points; all values are checked here.

        Requests are in the order of the map, not in that of the values. Adjacent points are
        written with one request, parts of registers with function 22.

        Args:
            values: the values by name, as `Point.encode` takes them.
            multiple: True to write even single coils and registers with functions 15 and 16,
                for devices that lack functions 5 and 6.
            sources: the values that were read of the points of `scale_sources`, by name.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; a value does
                not fit its point; points share cells. The message names the points.
            NoValue: a value of `sources` is missing or no scale.
        """
        self.scale_sources(values)
        known = sources or {}
        changes = [
            (point, values[name], known.get(point.scale_from or ""))
            for name, point in self.items()
            if name in values
        ]
        from .writing import write_requests  # brings the functions that write

        return write_requests(changes, multiple)

    def scale_sources(self, values: Mapping[str, Any]) -> list[str]:
        """
        Return the names of the points that must be read before these values can be written.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; or one of the
                points that must be read is to be written, too.
        """
        if not isinstance(values, Mapping):
            raise WrongType(
                "values", f"must be a mapping from names to values, not {type(values).__name__}"
            )
        for name in values:
            if not self._known(name).is_writable:
                raise WrongValue(name, "cannot be written: its access is read")
        for name in values:
            source = self._points[name].scale_from
            if source in values:
                raise WrongValue(
                    name,
                    f"is scaled by {source}, which must be written before, in a call of its own",
                )
        found = (self._points[name].scale_from for name in values)
        return list(dict.fromkeys(each for each in found if each is not None))

    def group(self, name: str) -> list[str]:
        """
        Return the names of the readable points of a group.

        Raises:
            ValueError: the group has no readable points.
        """
        found = [each.name for each in self._readable(None) if each.group == name and name]
        if not found:
            groups = sorted({each.group for each in self._readable(None)} - {""})
            known = f"; its groups are {', '.join(groups[:20])}" if groups else ""
            raise ValueError(f"the map has no points of a group {reprlib.repr(name)}{known}")
        return found

    def bind(self, client: MapClient, **options: Unpack[PlanOptions]) -> BoundMap:
        """
        Return the map bound to a client: ``meter.read()``, then ``meter.voltage``.

        Args:
            client: a blocking client; or an `AsyncClient`, whose `read` and `write` are awaited.
            options: the options of `Plan` for reading: `gap`, `forbidden`, `max_registers`,
                `max_bits`.

        Raises:
            TypeError: `client` is not a client.
        """
        from .bound_map import BoundMap  # most programs have no need of it

        return BoundMap(client, self, **options)

    def _readable(self, names: Sequence[str] | None) -> list[Point]:
        if names is None:
            return [point for point in self._points.values() if point.is_readable]
        for name in names:
            if not self._known(name).is_readable:
                raise WrongValue(name, "cannot be read: its access is write")
        return [self._points[name] for name in names]

    def _known(self, name: str) -> Point:
        if name in self._points:
            return self._points[name]
        raise ValueError(f"the map has no point {reprlib.repr(name)}{close_to(name, self._points)}")


def _checked_names(names: object) -> Iterable[str]:
    if isinstance(names, str | bytes) or not isinstance(names, Iterable):
        raise WrongType("names", f"must be a list of names, not {type(names).__name__}")
    return names


# --- points that scale others ---------------------------------------------------------------


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
