"""Plans that read points, and the points that scale them: the values of the answers, by name."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, Unpack

from ..protocol.errors import ModbusError
from ..protocol.mistakes import WrongValue
from ..protocol.tables import Table
from ..protocol.values import ValueType
from .items import Borders, PlanOptions
from .meaning import Meaning, NoValue
from .plan import Plan
from .point import Point
from .refusals import PartialAnswer
from .scaling import scaling_by


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


def sources_of(points: Iterable[Point], points_by_name: Mapping[str, Point]) -> dict[str, Point]:
    """Return the points that scale some points, by name; each before those that it scales."""
    sources: dict[str, Point] = {}
    for point in points:
        chain = []
        while (name := point.scale_from) is not None and name not in sources:
            point = points_by_name[name]
            chain.append(point)
        sources |= {source.name: source for source in reversed(chain)}
    return sources


def borders_of(points: Iterable[Point]) -> list[tuple[Table, int]]:
    """Return where points begin before which a request must end, as `Plan` takes it."""
    return [(point.table, point.address) for point in points if point.border]


FORMS = {"uint16": "H", "int16": "h"}
"""Type -> form of `struct`, if a register is the number."""


class _Quick(NamedTuple):
    """A point with one value in registers of one answer, and its fast decoder."""

    name: str
    data: int
    place: int | slice
    from_bytes: Callable[[bytes], Any] | None
    to_value: Callable[[Any], Any] | None
    judge: Callable[[Any, Callable[[Any], Any] | None], Any] | None
    scale: int | None


class PointPlan(Plan):
    """
    A `Plan` for points, whose results are values by name, and for `sources`, which scale them.

    Each of these stands before those that it scales.
    """

    def __init__(
        self,
        points: Iterable[Point],
        sources: Mapping[str, Point] | None = None,
        borders: Borders = (),
        **options: Unpack[PlanOptions],
    ) -> None:
        self._points = {point.name: point for point in points}
        self._sources = dict(sources or {})
        self._all = {**self._points, **self._sources}
        # Each scale has a number: looking up that is faster.
        self._numbers: dict[tuple[str, float, float, str], int] = {}
        scale_of: dict[str, int] = {}
        for name, point in self._all.items():
            if (source := point.scale_from) is None:
                continue
            if source not in self._sources:
                raise WrongValue.about("sources", f"{source}, which scales {name}, is missing")
            scale = source, point.scale, point.offset, point.scale_as
            scale_of[name] = self._numbers.setdefault(scale, len(self._numbers))
        reads = {name: point.read for name, point in self._all.items()}
        super().__init__(reads, borders=borders, **options)
        self._quick = list(self._quick_ones(scale_of))
        are_quick = {entry.name for entry in self._quick}
        self._slow = [name for name in self._points if name not in are_quick]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the points of the results, in their order."""
        return tuple(self._points)

    def _quick_ones(self, scale_of: dict[str, int]) -> Iterator[_Quick]:
        """The points that can be decoded directly, which is ten times as fast; most can."""
        for name, point in self._points.items():
            parts, kind, meaning = self._parts[name], point.read.kind, point.meaning
            if kind is not None and point.count == len(parts) == 1:
                request, start, stop = parts[0]
                judge = None if meaning.is_plain else meaning.judge
                others = point.to_value, judge, scale_of.get(name)
                if form := _form_of(kind, meaning):
                    at = request + (1 + list(FORMS.values()).index(form)) * len(self.requests)
                    yield _Quick(name, at, start, None, *others)
                else:
                    place = slice(2 * start, 2 * stop)
                    yield _Quick(name, request, place, meaning.from_bytes, *others)

    def _data(self, answers: list[Any]) -> list[Any]:
        """Return the bytes of each answer, and its registers in each of `FORMS`."""
        octets = [_packed(answer) for answer in answers]
        registers = [
            data and struct.unpack(f">{len(data) // 2}{form}", data)
            for form in FORMS.values()
            for data in octets
        ]
        return octets + registers

    def results(
        self, answers: Iterable[Sequence[Any] | ModbusError], *, return_exceptions: bool = False
    ) -> dict[str, Any]:
        """Return the values by name; None, or with `return_exceptions` a `NoValue`, for none."""
        answer_list = self._checked_answers(list(answers))
        data = self._data(answer_list)
        sources, functions = self._scales(answer_list)
        results: dict[str, Any] = dict.fromkeys(self._points)
        slow = self._slow.copy()
        for name, at, place, from_bytes, convert, judge, scale in self._quick:
            try:
                raw = data[at][place]
                if from_bytes is not None:
                    raw = from_bytes(raw)
                if scale is not None:
                    convert = functions[scale]
                if judge is not None:
                    value = judge(raw, convert)
                    if return_exceptions or value.__class__ is not NoValue:
                        results[name] = value
                    continue
                value = raw if convert is None else convert(raw)
                if value == value:  # only nan differs from itself
                    results[name] = value
                    continue
            except (TypeError, LookupError, ValueError):
                pass  # an error in place of the answer or the scale, or registers without a value
            slow.append(name)
        for answer in answer_list:
            if isinstance(answer, PartialAnswer):  # cells that were not read are zeros until here
                slow += [name for name in answer.lost if name in results]
        for name in slow:
            value = self._value(name, answer_list, sources)
            is_none = isinstance(value, NoValue) and not return_exceptions
            results[name] = None if is_none else value
        return results

    def _value(self, name: str, answers: list[Any], sources: dict[str, Any]) -> Any:
        """Return a value, a `NoValue`, or the error of the request."""
        point, cells = self._all[name], self._cells(name, answers)
        source = sources.get(point.scale_from or "")
        for part in (cells, source):
            if isinstance(part, ModbusError) and not isinstance(part, NoValue):
                return part
        try:
            results = point.meaning.values_in(cells, point.scaling_for(source))
        except NoValue as none:
            return none
        if point.count == 1:
            return results[0]
        return [None if isinstance(part, NoValue) else part for part in results]

    def _scales(self, answers: list[Any]) -> tuple[dict[str, Any], dict[int, Callable[[Any], Any]]]:
        """Return the values of the points that scale others, and the function of each scale."""
        values: dict[str, Any] = {}
        functions: dict[int, Callable[[Any], Any]] = {}
        for name in self._sources:
            value = values[name] = self._value(name, answers, values)
            for (source, *scale), number in self._numbers.items():
                if source == name and isinstance(value, int | float):
                    with contextlib.suppress(ValueError):
                        functions[number] = scaling_by(*scale, value).to_value
        return values, functions


def _form_of(kind: ValueType, meaning: Meaning) -> str:
    """Return the form of `struct` equal to the decoder of one register, or an empty text."""
    if kind.registers != 1 or kind.order != "ABCD" or meaning.part is not None:
        return ""
    return FORMS["uint16"] if meaning.bits else FORMS.get(kind.name, "")


def _packed(answer: Any) -> bytes | None:
    """Return the bytes of registers; None for bits, errors and values out of 0..65535."""
    if isinstance(answer, PartialAnswer):
        answer = [0 if cell is None else cell for cell in answer]
    try:
        return struct.pack(f">{len(answer)}H", *answer)
    except (TypeError, struct.error):
        return None
