"""
The points of a device by name: the requests that read them, and the values of the answers.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Unpack

from ..protocol import pdu
from ..protocol.errors import ModbusError
from ..protocol.mistakes import WrongType, WrongValue
from .holes import HolesByDevice
from .plan import Plan, PlanOptions
from .point import Point

__all__ = ["PointPlan", "RegisterMap", "close_to"]


class RegisterMap(Mapping[str, Point]):
    """
    The points of one kind of device: name -> `Point`, in their order. It never changes.

    ``plc.read_map(map)`` and ``plc.write_map(map, values)`` of the clients use it;
    `load_map` reads it from a file. Points may overlap, such as two readings of a register.

    Args:
        points: each with a name of its own.

    Raises:
        TypeError, ValueError: an argument is no Point, or a name occurs twice.
    """

    __slots__ = ("_holes", "_kept", "_points")

    def __init__(self, points: Iterable[Point]) -> None:
        self._points: dict[str, Point] = {}
        self._kept: tuple[object, PointPlan] | None = None
        self._holes = HolesByDevice()
        for point in points:
            if not isinstance(point, Point):
                raise WrongType("points", f"must be Points, not {type(point).__name__}")
            if point.name in self._points:
                raise WrongValue("name", f"{point.name!r} is there twice")
            self._points[point.name] = point

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
            options: of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be read; or as `Plan`.
        """
        wanted = None if names is None else tuple(_checked_names(names))
        asked = (wanted, options)
        if (kept := self._kept) is not None and kept[0] == asked:
            return kept[1]
        made = PointPlan(self._readable(wanted), **options)
        made.holes = self._holes
        # The caller may change the list of forbidden ranges later.
        if "forbidden" not in options:
            self._kept = (asked, made)
        return made

    def writes(
        self, values: Mapping[str, Any], *, multiple: bool = False
    ) -> list[pdu.Request[None]]:
        """
        Return the requests that write values to points; all values are checked here.

        Requests follow the order of the map, not that of the values. Points that lie directly
        behind each other are written with one request.

        Args:
            values: by names of points, as `Point.encode` takes them.
            multiple: True to write single coils and registers with functions 15 and 16,
                    too, for devices that lack 5 and 6.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; a value does
                    not fit its point; points share cells. The message names the points.
        """
        if not isinstance(values, Mapping):
            raise WrongType("values", f"must be by names, not {type(values).__name__}")
        for name in values:
            if not self._known(name).is_writable:
                raise WrongValue(name, "cannot be written: its access is read")
        changes = [(point, values[name]) for name, point in self.items() if name in values]
        from .writing import write_requests  # brings the functions that write

        return write_requests(changes, multiple)

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


def close_to(name: object, known: Iterable[str]) -> str:
    """Return the end of a message about a name that is not known: those that are close to it."""
    from difflib import get_close_matches

    close = get_close_matches(name, known, 3) if isinstance(name, str) else []
    return f"; close to it are {', '.join(close)}" if close else ""


class _Quick(NamedTuple):
    """A point with one value in registers of one answer: their location, and their decoder."""

    request: int
    start: int
    stop: int
    from_bytes: Callable[[bytes], Any]
    to_value: Callable[[Any], Any] | None


class PointPlan(Plan):
    """
    A `Plan` for points of a map, whose results are their values by name.

    ``plc.read_many(plan)`` returns the same dict.
    """

    def __init__(self, points: Iterable[Point], **options: Unpack[PlanOptions]) -> None:
        self._points = {point.name: point for point in points}
        super().__init__({name: point.read for name, point in self._points.items()}, **options)
        self._quick = dict(self._quick_ones())

    def _quick_ones(self) -> Iterator[tuple[str, _Quick]]:
        """The points that can be decoded directly, which is ten times as fast; most can."""
        for name, point in self._points.items():
            parts, kind = self._parts[name], point.read.kind
            if kind is not None and point.count == len(parts) == 1:
                request, start, stop = parts[0]
                quick = _Quick(request, 2 * start, 2 * stop, kind.from_bytes, point.to_value)
                yield name, quick

    def results(
        self, answers: Iterable[Sequence[Any] | ModbusError], *, return_exceptions: bool = False
    ) -> dict[str, Any]:
        """
        Return the values of the points.

        Args:
            answers: the answer to each of `requests`, in their order: a list
                    of cells, or a ModbusError.
            return_exceptions: True to return a ValueError in place of a value that the
                    registers do not hold, such as a bcd16 with the digit F; False to raise it.

        Returns:
            Values by name. A point that was part of a failed request has the
            ModbusError instead.

        Raises:
            ValueError: answers that are not to these requests; registers that hold no such
                value, by the name of the point.
        """
        given = self._checked_answers(list(answers))
        data = [_packed(answer) for answer in given]
        found: dict[str, Any] = {}
        for name in self._points:
            try:
                found[name] = self._value(name, given, data)
            except ValueError as error:
                if not return_exceptions:
                    raise
                found[name] = error
        return found

    def _value(self, name: str, answers: list[Any], data: list[bytes | None]) -> Any:
        quick = self._quick.get(name)
        if quick is None or (packed := data[quick.request]) is None:
            return self._values(name, answers)
        try:
            raw = quick.from_bytes(packed[quick.start : quick.stop])
        except ValueError:
            return self._values(
                name, answers
            )  # `Plan.results` raises the error that says what is wrong
        return raw if quick.to_value is None else quick.to_value(raw)

    def _decoded(self, name: str, cells: list[Any]) -> Any:
        return self._points[name].decode(cells)


def _packed(answer: Any) -> bytes | None:
    """Return the bytes of registers; None for bits, errors and values out of 0..65535."""
    try:
        return struct.pack(f">{len(answer)}H", *answer)
    except (TypeError, struct.error):
        return None


def _checked_names(names: object) -> Iterable[str]:
    if isinstance(names, str | bytes) or not isinstance(names, Iterable):
        raise WrongType("names", f"must be a list of names, not {type(names).__name__}")
    return names
