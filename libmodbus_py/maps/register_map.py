"""The points of a device by name: the requests that read them, and the values of the answers."""

from __future__ import annotations

import reprlib
from collections.abc import Awaitable, Iterable, Iterator, Mapping, Sequence
from os import PathLike
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, Unpack

from ..protocol import pdu
from ..protocol.checks import instance
from ..protocol.mistakes import WrongType, WrongValue, close_to
from ..protocol.tables import WriteFunction, checked_write_function
from .items import PlanOptions
from .point import Point, attribute_names
from .point_plan import PointPlan, borders_of, scale_mistakes, sources_of

if TYPE_CHECKING:
    from .list_words import ListKeys, ListOptions  # most programs read no list


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

    __slots__ = ("_last", "_points")

    def __init__(self, points: Iterable[Point]) -> None:
        self._points: dict[str, Point] = {}
        self._last: tuple[object, PointPlan] | None = None
        for point in points:
            if instance("points", point, Point, "Point objects").name in self._points:
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

    @property
    def initial(self) -> dict[str, Any]:
        """The initial values of points that have one, by name."""
        return {name: point.initial for name, point in self.items() if point.initial is not None}

    def plan(self, names: Iterable[str] | None = None, **options: Unpack[PlanOptions]) -> PointPlan:
        """
        Return the plan that reads points; the plan made last is cached.

        Args:
            names: names of points, in the order of the results; None for all readable points.
            options: the options of `Plan`: `gap`, `forbidden`, `max_registers`, `max_bits`.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be read; or as for `Plan`.
        """
        arguments = None if names is None else tuple(_checked_names(names)), options
        if self._last is not None and self._last[0] == arguments:
            return self._last[1]
        points = self._readable(arguments[0])
        sources = sources_of(points, self._points)
        plan = PointPlan(points, sources, borders_of(self._points.values()), **options)
        # The caller may change the list of forbidden ranges later.
        if "forbidden" not in options:
            self._last = (arguments, plan)
        return plan

    def writes(
        self,
        values: Mapping[str, Any],
        *,
        write_function: WriteFunction = "auto",
        sources: Mapping[str, Any] | None = None,
    ) -> list[pdu.Request[None]]:
        """
        Return the requests that write values to points; all values are checked here.

        Requests are in the order of the map, not in that of the values. Adjacent points are
        written with one request, parts of registers with function 22.

        Args:
            values: the values by name, as `Point.encode` takes them.
            write_function: "single" for functions 5 and 6, with a request for each coil or
                register, so that a device sees a value of two registers in two halves; "multiple"
                for 15 and 16; "auto" for 5 and 6 for single ones, 15 and 16 for several. Points
                may name their own (`Point.write_function`).
            sources: the values that were read of the points of `scale_sources`, by name.

        Raises:
            TypeError, ValueError: there is no such point, or it cannot be written; a value does
                not fit its point; points share cells. The message names the points.
            NoValue: a value of `sources` is missing or no scale.
        """
        self.scale_sources(values)
        scales = sources or {}
        changes = [
            (point, values[name], scales.get(point.scale_from or ""))
            for name, point in self.items()
            if name in values
        ]
        from .writing import write_requests  # brings the functions that write

        return write_requests(changes, checked_write_function(write_function))

    def scale_sources(self, values: Mapping[str, Any]) -> list[str]:
        """
        Return the names of the points that must be read before these values can be written; raise
        TypeError or ValueError as `writes`, and if one of these points is to be written, too.
        """
        sources: dict[str, None] = {}
        for name in instance("values", values, Mapping, "a mapping from names to values"):
            point = self._known(name)
            if not point.is_writable:
                raise WrongValue(name, "cannot be written: its access is read")
            if (source := point.scale_from) in values:
                hint = "which must be written before, in a call of its own"
                raise WrongValue(name, f"is scaled by {source}, {hint}")
            sources |= {} if source is None else {source: None}
        return list(sources)

    def group(self, name: str) -> list[str]:
        """
        Return the names of the readable points of a group.

        Raises:
            ValueError: the group has no readable points.
        """
        names = [point.name for point in self._readable(None) if point.group == name and name]
        if not names:
            groups = sorted({point.group for point in self._readable(None)} - {""})
            hint = f"; its groups are {', '.join(groups[:20])}" if groups else ""
            raise ValueError(f"the map has no points of a group {reprlib.repr(name)}{hint}")
        return names

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


AnyMap: TypeAlias = RegisterMap | str | PathLike[str]
"""A register map, or the path of its file."""


def map_of(map: AnyMap, name: str = "map") -> RegisterMap:
    """Return a register map, or load that of a file; `name` is that of the argument, for errors."""
    if isinstance(map, RegisterMap):
        return map
    form = "a RegisterMap or the path of its file"
    return load_map(instance(name, map, (str, PathLike), form))


def load_map(
    path: str | PathLike[str],
    *,
    columns: Mapping[str, Any] | None = None,
    **options: Unpack[ListKeys],
) -> RegisterMap:
    """
    Return the register map of a file.

    Args:
        path: the path of the file. If it ends with ``.toml``, the file has a table ``[[point]]``
            for each point, with the arguments of `Point` as keys, and ``[defaults]`` for all. If it
            ends with ``.csv``, ``.tsv``, ``.txt``, ``.md`` or ``.xlsx``, it is a list: it has a row
            for each point, and columns that are recognised by their headings, as vendors name them.
        columns: the headings of columns that are not recognised, by the arguments of `Point` or
            headings that are, such as ``{"name": "Bezeichnung"}``; those under "nothing" are
            ignored. Only for lists, as all that follow.
        options: how a list is read, where it does not say it: `origin` ("iobroker", "modpoll",
            "nibe" or "victron"), `encoding`, `sheet`, `only`, `types`, `first_address`, `table`,
            `access`, `order`, `lengths` (``docs/how-to/register-lists.md``).

    Raises:
        MapError: the file cannot be read, contains a mistake, or has two meanings. The message
            describes the first one, with file, line, column and what is allowed.
        ValueError: `columns` has a name that is no argument of `Point`, or the file no columns.
    """
    from .list_words import ListOptions  # most programs read no list

    return map_with(path, ListOptions(columns=columns or {}, **options))


def map_with(path: str | PathLike[str], options: ListOptions) -> RegisterMap:
    """Return the register map of a file; otherwise as `load_map`."""
    from .map_file import contents_of  # most programs read no file

    contents = contents_of(path, most=1, options=options)
    if contents.mistakes:
        raise contents.mistakes[0]
    return RegisterMap(contents.points.values())


# --- with a client ------------------------------------------------------------------------


class MapClient(Protocol):
    """A client, blocking or not."""

    @property
    def read_map(self) -> Any:
        """The method that reads points of a map."""

    @property
    def write_map(self) -> Any:
        """The method that writes points of a map."""


class MapBinding:
    """
    The base of bound maps: a register map with a client, and the values that were read.

    Args:
        client: a blocking client or an `AsyncClient`.
        map: a `RegisterMap`, or the path of its file.
        options: the options of `Plan` for reading: `gap`, `forbidden`, `max_registers`, `max_bits`.

    Attributes:
        client: as given.
        map: the map.

    Raises:
        TypeError: `client` is not a client, or `map` neither a map nor a path.
        MapError: as for `load_map`.
    """

    def __init__(self, client: MapClient, map: AnyMap, **options: Unpack[PlanOptions]) -> None:
        if not callable(getattr(client, "read_map", None)):
            raise WrongType("client", f"must be a client, not {type(client).__name__}")
        self.client: Any = client
        self.map: RegisterMap = map_of(map)
        self._options = options
        self._values: dict[str, Any] = {}
        self._attributes = attribute_names(self.map)
        self._names = {attribute: name for name, attribute in self._attributes.items()}

    def __getitem__(self, name: str) -> Any:
        """Return a value by the point's name in the map; KeyError if unknown, or not read yet."""
        if name in self._values:
            return self._values[name]
        if name in self.map:
            raise KeyError(f"{name!r} has not been read: call read()")
        raise KeyError(f"there is no point {name!r}{close_to(name, self.map)}")

    def __setattr__(self, attribute: str, value: object) -> None:
        if attribute in self.__dict__.get("_names", ()):
            raise AttributeError(f"{attribute} is written by write({attribute}=...)")
        super().__setattr__(attribute, value)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} of {len(self.map)} points: {self._values!r}>"

    def _read(self, attributes: Iterable[str]) -> Any:
        """Read points, all if no attribute is given; return None, or a coroutine for it."""
        names = [self._named(attribute) for attribute in attributes] or None
        result = self.client.read_map(self.map, names, **self._options)
        if hasattr(result, "__await__"):
            return self._update(result)
        return self._values.update(result)

    async def _update(self, result: Awaitable[Mapping[str, Any]]) -> None:
        self._values.update(await result)

    def _write(self, values: Mapping[str, Any]) -> Any:
        """Write values by attribute; return None, or a coroutine for it."""
        by_name = {self._named(attribute): value for attribute, value in values.items()}
        return self.client.write_map(self.map, by_name)

    def _value(self, name: str) -> Any:
        """Return the value of a point, None for none; raise AttributeError if it was not read."""
        if name not in self._values:
            raise AttributeError(f"{self._attributes[name]} has not been read: call read()")
        return self._values[name]

    def _certain(self, name: str) -> Any:
        """Return a value that cannot be missing; raise ValueError if it is, such as for a nan."""
        value = self._value(name)
        if value is None:
            raise ValueError(f"{name} has no value")
        return value

    def _named(self, attribute: str) -> str:
        if attribute in self._names:
            return self._names[attribute]
        close = close_to(attribute, self._names)
        raise AttributeError(f"there is no attribute {attribute!r}{close}")


class BoundMap(MapBinding):
    """
    A register map, bound to a client: ``meter.read()``, then ``meter.voltage``.

    With an `AsyncClient`, `read` and `write` are awaited. An attribute has the value of the last
    successful `read`, or None if there is no value; before the first one it raises AttributeError.
    Using it sends nothing. The classes that ``libmodbus-py map class`` writes work in the same way,
    and type checkers know their attributes.

    The attribute of a point is its name, if that is an identifier. In other names, every run of
    characters that identifiers cannot contain is replaced by one ``_``, and removed at the ends. A
    name that begins with a digit gets the prefix "point_", one that Python or this class uses gets
    the suffix ``_``, and duplicates get ``_2``, ``_3`` and so on. ``meter["voltage L1"]`` returns
    the value by the original name.
    """

    def read(self, *attributes: str) -> Any:
        """
        Read the points of these attributes; without arguments, all readable points.

        Returns:
            None; a coroutine with an `AsyncClient`.

        Raises:
            AttributeError: there is no such attribute.
            ModbusError, TypeError, ValueError: as for `read_map`; no value has changed.
        """
        return self._read(attributes)

    def write(self, **values: Any) -> Any:
        """
        Write values to points, by their attributes: ``meter.write(setpoint=21.5)``.

        All values are checked before the first byte is sent. Attributes change with the next
        `read`.

        Returns:
            None; a coroutine with an `AsyncClient`.

        Raises:
            AttributeError: there is no such attribute.
            ModbusError, TypeError, ValueError: as for `write_map`.
        """
        return self._write(values)

    def __getattr__(self, attribute: str) -> Any:
        if attribute.startswith("_"):  # read before __init__, such as in copy.copy
            raise AttributeError(attribute)
        return self._value(self._named(attribute))

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._names})
