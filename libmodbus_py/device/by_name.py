"""
The access of a device to its values by the names of its points.

Most servers have no points: maps, and the functions for values of points, are imported when the
first device has some.
"""

from __future__ import annotations

from collections.abc import Mapping as MappingABC
from types import ModuleType
from typing import TYPE_CHECKING, Any

from .mapping import Mapping

if TYPE_CHECKING:
    from ..maps.register_map import RegisterMap

__all__ = ["NamedValues"]


def _functions() -> ModuleType:
    from . import named_values

    return named_values


class NamedValues:
    """
    The part of a `Device` that has values by name: ``device["setpoint"] = 21.5``.

    Raises:
        TypeError: `mapping` is no Mapping, or `points` no RegisterMap.
        ValueError: a point has cells that the mapping lacks; the message names it.

    Attributes:
        has_points: True if points were given.
    """

    def __init__(self, mapping: Mapping, points: RegisterMap | None) -> None:
        if not isinstance(mapping, Mapping):
            raise TypeError(f"mapping must be a Mapping, not {type(mapping).__name__}")
        if points is not None:
            _functions().check_points(mapping, points)
        self.mapping = mapping
        self.has_points: bool = points is not None
        self._points = points

    @property
    def points(self) -> RegisterMap:
        """The points by name; empty if none were given."""
        if self._points is None:
            from ..maps.register_map import RegisterMap

            return RegisterMap(())
        return self._points

    def __getitem__(self, name: str) -> Any:
        """
        Return the value of a point, without calling `before_read`; None if it has none.

        Raises:
            KeyError: there is no such point.
            ValueError: its cells hold no value of its type.
        """
        of = _functions()
        point = of.known_point(self.points, name)
        with self.mapping.lock:
            source = of.source_after(point, self.points, self.mapping)
            return point.decode(of.cells_after(point, self.mapping), source=source)

    def __setitem__(self, name: str, value: Any) -> None:
        """
        Set the value of a point; no hook is called.

        Raises:
            KeyError: there is no such point.
            TypeError, ValueError: as of `Point.encode`; the message names the point.
        """
        self.update({name: value})

    def update(self, values: MappingABC[str, Any]) -> None:
        """
        Set values of points by name, all of them or none. No hook is called.

        No request is answered while the values are set.

        Raises:
            KeyError: there is no such point.
            TypeError, ValueError: a value does not fit its point, or points share cells; the
                message names the points.
        """
        with self.mapping.lock:
            _functions().set_values(self.mapping, self.points, values)
