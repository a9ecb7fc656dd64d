"""
The bounds of points that other points scale, when a value that scales them is written.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Mapping as MappingABC

from ..maps.bounds import check_cells, has_bounds
from ..maps.point import Point
from ..maps.point_plan import sources_of
from ..protocol.mistakes import WrongValue
from .access import Access
from .mapping import Mapping
from .point_index import PointIndex, RuledCells
from .values_after import NOTHING, Written, cells_after, source_after

__all__ = ["ScaledBounds"]


class ScaledBounds:
    """
    The points of a device that have bounds and `scale_from`, by the cells that scale them.

    No write of these cells may take such a point out of its bounds. One that is outside already
    does not matter, so that a device without values can be set up in any order.

    Args:
        points: all points of the device, by name.

    Attributes:
        scales: the cells that scale, each with the point that it scales.
    """

    def __init__(self, points: MappingABC[str, Point]) -> None:
        self._points = points
        self.scales: list[RuledCells] = [
            RuledCells.of(source)._replace(point=point)
            for point in points.values()
            if has_bounds(point)
            for source in sources_of([point], points).values()
        ]
        self._index = PointIndex(self.scales)

    def check(self, writes: Iterable[Access], written: Written, mapping: Mapping) -> None:
        """
        Check writes that are not done yet. Hold the mapping's lock.

        Args:
            writes: their places.
            written: what they write.

        Raises:
            ValueError: a point would leave its bounds; the message names it.
        """
        for access in writes if self.scales else ():
            for point in self._index.touched(access):
                if self._is_within(point, mapping):
                    self._check(point, mapping, written)

    def _is_within(self, point: Point, mapping: Mapping) -> bool:
        try:
            self._check(point, mapping, NOTHING)
        except (IndexError, ValueError):
            return False
        return True

    def _check(self, point: Point, mapping: Mapping, written: Written) -> None:
        try:
            source = source_after(point, self._points, mapping, written)
            check_cells(point, cells_after(point, mapping, written), source=source)
        except ValueError as error:
            reason = f"{point.scale_from} scales it, and {error}"
            raise WrongValue.about(point.name, reason) from None
