"""
Runs: the values of a simulated device, each with its place and its kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from ...maps.scaling import Scaling
from ...protocol.checks import shown
from ...protocol.values import ValueType

__all__ = ["BIT", "Behaviour", "Compute", "Kind", "Run", "Runs", "ScaledType", "fitting"]

Number = int | float

# Computes the values with these indices in their run at a time, in seconds since the start.
Compute = Callable[[range, float], list[Any]]


class Kind(Protocol):
    """What values are, and how they lie in cells; a `ValueType` is one."""

    @property
    def name(self) -> str: ...

    @property
    def registers(self) -> int: ...

    @property
    def limits(self) -> tuple[int, int] | tuple[float, float] | None: ...

    @property
    def order(self) -> str: ...

    def encode(self, value: Any) -> list[int]: ...

    def encode_many(self, values: Iterable[Any]) -> list[int]: ...

    def decode_many(self, registers: Iterable[int]) -> list[Any]: ...


@dataclass(frozen=True)
class ScaledType:
    """
    Numbers that stand for others: a register holds 2305, and the value is 230.5.

    Of integers the nearest one is taken.

    Attributes:
        limits: the lowest and the highest value.
        step: between two values; 0 for floats.
    """

    kind: ValueType
    scale: float
    offset: float
    limits: tuple[int, int] | tuple[float, float]
    step: float
    _scaling: Scaling

    @classmethod
    def of(cls, kind: ValueType, scale: float, offset: float) -> ScaledType:
        """
        Raises:
            TypeError, ValueError: scale or offset cannot be, or the kind is no number.
        """
        scaling = Scaling(scale, offset)
        if kind.limits is None:
            raise ValueError(f"scale and offset mean nothing for {kind.name}, which is no number")
        low, high = sorted(map(scaling.to_value, kind.limits))
        step = abs(scale) if isinstance(kind.limits[0], int) else 0
        return cls(kind, scale, offset, (low, high), step, scaling)

    @property
    def name(self) -> str:
        return self.kind.name

    @property
    def registers(self) -> int:
        return self.kind.registers

    @property
    def order(self) -> str:
        return self.kind.order

    def encode(self, value: Any) -> list[int]:
        return self.kind.encode(self._raw(value))

    def encode_many(self, values: Iterable[Any]) -> list[int]:
        return self.kind.encode_many([self._raw(value) for value in values])

    def decode_many(self, registers: Iterable[int]) -> list[Any]:
        return [self._scaling.to_value(raw) for raw in self.kind.decode_many(registers)]

    def _raw(self, value: Any) -> Number:
        if not self.step:
            return self._scaling.to_float(value)
        raw = self._scaling.to_whole(value)
        low, high = self.kind.limits or (raw, raw)
        if not low <= raw <= high:
            span = f"{self.limits[0]}..{self.limits[1]}"
            raise ValueError(f"value must be in {span}, not {shown(value)}")
        return raw


def _pack_bit(name: str, value: object) -> bytes:
    if value not in (0, 1) or isinstance(value, float):
        raise ValueError(f"{name} must be true or false, not {value!r}")
    return bytes([0, value == 1])


BIT = ValueType("bit", 1, _pack_bit, lambda data: data[1], limits=(0, 1))
"""What coils and discrete inputs hold: True and False, or 1 and 0."""


def fitting(kind: Kind, value: Any) -> Any:
    """Give the number of this kind that is nearest; 0 for nan. What is no number fits."""
    if kind.limits is None:
        return value
    if value != value:  # nan; math.isnan cannot take the largest integers
        return 0
    low, high = kind.limits
    nearest = min(max(value, low), high)
    return round(nearest) if isinstance(low, int) else float(nearest)


@dataclass(frozen=True, slots=True)
class Run:
    """
    Values of one kind, one after the other in a table.

    Attributes:
        table: its name, as in `Mapping`.
        first: the address where the first value begins, 0..65535.
        count: how many values.
        kind: what they are.
        behaviour: how they move; None if they do not.
    """

    table: str
    first: int
    count: int
    kind: Kind
    behaviour: Behaviour | None = None

    @property
    def stop(self) -> int:
        """The address behind the last value."""
        return self.first + self.count * self.kind.registers

    def place(self, indices: range) -> slice:
        """The addresses from the first of these values to the last."""
        width = self.kind.registers
        return slice(self.first + indices[0] * width, self.first + (indices[-1] + 1) * width)


class Runs(Protocol):
    """All values of a device, for those that follow others; `Clockwork` is one."""

    @property
    def seed(self) -> int:
        """What random moves begin with that have no seed of their own."""
        ...

    def find(self, table: str, address: int) -> Run | None:
        """Give the run that has an address."""
        ...

    def values(self, run: Run, indices: range, now: float) -> list[Any]:
        """Give some values, at a time since the start."""
        ...


class Behaviour(Protocol):
    """How the values of a run move. TypeError, ValueError: an attribute that cannot be."""

    def begin(self, run: Run, runs: Runs) -> Compute:
        """
        Say how the values of a run are computed.

        Raises:
            ValueError: this does not go with what the run's values are.
        """
        ...
