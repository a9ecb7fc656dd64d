"""
Register maps bound to clients: values as attributes.
"""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Coroutine, Iterable, Mapping
from typing import Any, Protocol, Unpack

from ..protocol.close_names import close_to
from ..protocol.mistakes import WrongType
from .plan import PlanOptions
from .point import Point

__all__ = ["BoundMap", "MapBinding", "MapClient", "attribute_names", "class_name"]

RESERVED = frozenset(
    {
        *("bind", "client", "datetime", "map", "read", "self", "write"),
        *("bool", "dict", "float", "int", "list", "property", "str", "super"),
    }
)
"""Names that no attribute may have, because bound maps and their classes use them."""


class MapClient(Protocol):
    """A client, blocking or not."""

    @property
    def read_map(self) -> Any:
        """The method that reads points of a map."""
        ...

    @property
    def write_map(self) -> Any:
        """The method that writes points of a map."""
        ...


class MapBinding:
    """
    The base of bound maps: a register map with a client, and the values that were read.

    Args:
        client: a blocking client or an `AsyncClient`.
        map: a `RegisterMap`.
        options: the options of `Plan` for reading: `gap`, `forbidden`, `max_registers`, `max_bits`.

    Attributes:
        client, map: as given.

    Raises:
        TypeError: `client` is not a client.
    """

    def __init__(
        self, client: MapClient, map: Mapping[str, Point], **options: Unpack[PlanOptions]
    ) -> None:
        if not callable(getattr(client, "read_map", None)):
            raise WrongType("client", f"must be a client, not {type(client).__name__}")
        self.client: Any = client
        self.map: Mapping[str, Point] = map
        self._options = options
        self._values: dict[str, Any] = {}
        self._attributes = attribute_names(map)
        self._names = {attribute: name for name, attribute in self._attributes.items()}

    def __getitem__(self, name: str) -> Any:
        """
        Return the value of a point by its name in the map.

        Raises:
            KeyError: there is no such point, or it has not been read.
        """
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
        names = [self._named(each) for each in attributes] or None
        found = self.client.read_map(self.map, names, **self._options)
        if hasattr(found, "__await__"):
            return self._keep_later(found)
        self._values.update(found)
        return None

    async def _keep_later(self, coming: Coroutine[Any, Any, Mapping[str, Any]]) -> None:
        self._values.update(await coming)

    def _write(self, values: Mapping[str, Any]) -> Any:
        """Write values by attribute; return None, or a coroutine for it."""
        given = {self._named(attribute): value for attribute, value in values.items()}
        return self.client.write_map(self.map, given)

    def _value(self, name: str) -> Any:
        """
        Return the value of a point, None for no value.

        Raises:
            AttributeError: it has not been read.
        """
        if name not in self._values:
            raise AttributeError(f"{self._attributes[name]} has not been read: call read()")
        return self._values[name]

    def _certain(self, name: str) -> Any:
        """
        Return the value of a point for which the map knows no values that mean none.

        Raises:
            AttributeError: it has not been read.
            ValueError: there is no value all the same, such as for a nan.
        """
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
        if attribute.startswith("_"):  # before __init__, such as in copy.copy
            raise AttributeError(attribute)
        return self._value(self._named(attribute))

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._names})


# --- names of attributes ------------------------------------------------------------------


def attribute_names(names: Iterable[str]) -> dict[str, str]:
    """
    Return the attribute for the name of each point.

    A name that is an identifier of its own stays as it is. In others every run of characters that
    no identifier has becomes one ``_``, and those at the ends are removed; "point" stands for
    nothing, and "point_" before a digit. A name that Python or the class itself uses gets ``_``
    behind it, and one that is taken ``_2``, ``_3`` and so on, in the order of the names.
    """
    given = list(names)
    found = {name: name for name in given if _identifier(name) == name}
    taken = set(found)
    for name in given:
        if name not in found:
            found[name] = _free(_identifier(name), taken)
            taken.add(found[name])
    return {name: found[name] for name in given}


def class_name(stem: str) -> str:
    """Return the name of a class for a file without its ending: ``Sdm630V2`` for "sdm630-v2"."""
    words = [each for each in re.split("_+", _spelled(stem)) if each]
    text = "".join(word[0].upper() + word[1:] for word in words) or "Meter"
    text = unicodedata.normalize("NFKC", text)
    return text if text.isidentifier() and not keyword.iskeyword(text) else f"Map{text}"


def _identifier(name: str) -> str:
    text = _spelled(name).strip("_") or "point"
    if not text.isidentifier():
        text = f"point_{text}"
    return f"{text}_" if keyword.iskeyword(text) or text in RESERVED else text


def _spelled(name: str) -> str:
    """Return a name with one ``_`` for each run of characters that no identifier has."""
    # As Python itself spells identifiers; twice, because some letters become others and a space.
    text = unicodedata.normalize("NFKC", name)
    text = "".join(each if f"a{each}".isidentifier() else " " for each in text)
    return unicodedata.normalize("NFKC", re.sub(" +", "_", text))


def _free(text: str, taken: set[str]) -> str:
    number, found = 1, text
    while found in taken:
        number += 1
        found = f"{text}_{number}"
    return found
