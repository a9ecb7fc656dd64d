"""
The SunSpec models that were found in a device.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

from ...maps.point import Point
from ...maps.register_map import RegisterMap
from .chain import MARKER, Header

__all__ = ["SunSpecDevice", "SunSpecModel"]


@dataclass(frozen=True)
class SunSpecModel:
    """
    One model of a device.

    Attributes:
        id: the id of the model, such as 103; 1..65534.
        address: the address of the register with the id.
        length: the number of registers after id and length.
        name: the name of the model, such as "common", unique in its device; "model_64999" if the
            model is not known.
        label: the title of the model, or empty.
        is_known: True if pysunspec2 has a definition of the model; if not, the point `registers`
            contains all registers after the header.
        map: the points, with `ID` and `L`. The names of points in repeated groups are like
            "module.1.DCA", counted from 1.
    """

    id: int
    address: int
    length: int
    name: str
    label: str
    is_known: bool
    map: RegisterMap


@dataclass(frozen=True)
class SunSpecDevice:
    """
    The models of a device.

    Attributes:
        base: the address at which the chain begins, with "SunS".
        models: in the order of the chain.
        end: the address of the end model; None if the chain ends without one.
        notes: what is wrong with the chain or its models, each as one sentence.
    """

    base: int
    models: tuple[SunSpecModel, ...]
    end: int | None
    notes: tuple[str, ...]

    @cached_property
    def map(self) -> RegisterMap:
        """The points of all models, such as "common.Mn", with the marker and the end model."""
        found = [
            Point("SunS", "holding_registers", self.base, len(MARKER), access="read"),
            *(point for model in self.models for point in _prefixed(model)),
        ]
        if self.end is not None:
            found.append(Point("end.ID", "holding_registers", self.end, access="read"))
            found.append(Point("end.L", "holding_registers", self.end + 1, access="read"))
        return RegisterMap(found)

    def __getitem__(self, model: int | str) -> SunSpecModel:
        """
        Return the first model with this id or name.

        Raises:
            KeyError: the device has none.
        """
        for each in self.models:
            if model in (each.id, each.name):
                return each
        raise KeyError(model)

    def __iter__(self) -> Iterator[SunSpecModel]:
        return iter(self.models)

    def __len__(self) -> int:
        return len(self.models)


def _prefixed(model: SunSpecModel) -> Iterator[Point]:
    for point in model.map.values():
        source = point.scale_from
        yield replace(
            point,
            name=f"{model.name}.{point.name}",
            scale_from=None if source is None else f"{model.name}.{source}",
        )


def names_of(headers: Iterable[Header], known: Iterable[str | None]) -> Iterator[str]:
    """Yield a name for each model; the second one of a name ends with 2, and so on."""
    seen: dict[str, int] = {"end": 1, "SunS": 1}
    for header, given in zip(headers, known, strict=True):
        name = given or f"model_{header.id}"
        seen[name] = seen.get(name, 0) + 1
        yield name if seen[name] == 1 else f"{name}_{seen[name]}"
