"""
One named value of a device: its location and the meaning of its cells.
"""

from __future__ import annotations

import functools
import reprlib
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from ..protocol.checks import shown
from ..protocol.mistakes import Mistake, WrongType, WrongValue
from ..protocol.pdu.fields import checked_bit, checked_sequence, store
from ..protocol.tables import TABLES, Table
from ..protocol.values import Order, TypeName, ValueType
from .plan import Read
from .scaling import Scaling, exact, number

__all__ = ["ACCESSES", "MAX_DESCRIPTION", "Point", "Rights"]

Rights = Literal["read", "write", "read_write"]

ACCESSES = ("read", "write", "read_write")

MAX_NAME, MAX_UNITS, MAX_DESCRIPTION = 100, 50, 2000


@dataclass(frozen=True)
class Point:
    """
    One named value of a device, or several of one kind.

    Args:
        name: unique in its map; 1..100 printable characters.
        table: "coils", "discrete_inputs", "holding_registers" or "input_registers".
        address: its first cell, 0..65535.
        count: how many values; 1 for the value itself, more for a list of them.
        type: how registers are interpreted, such as "float32" (`libmodbus_py.values`), uint16
            unless given; None in tables of bits, whose values are True and False.
        order, encoding, padding: of the type, as for `values.value_type`.
        scale, offset: value = raw * scale + offset, for numbers, as exact as they are
            written: 2305 times 0.1 is 230.5. Integers stay integers where both are whole.
            Each -1e30..1e30; the scale not nearer to 0 than 1e-30.
        units: of the value, such as "V" or "kWh"; up to 50 characters. `unit` is the old name.
        access: "read", "write" or "read_write": what clients may do. Unless given
            "read_write", and "read" for discrete inputs and input registers.
        minimum, maximum: what may be written, both included, in scaled values; None for
            no bound but the type's.
        description: up to 2000 characters.

    Attributes:
        read: the `Read` of all cells, for a `Plan`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range; the message begins
            with its name.
    """

    name: str
    table: Table
    address: int
    count: int = 1
    type: TypeName | None = None
    order: Order = "ABCD"
    encoding: str = "ascii"
    padding: str = "\0"
    scale: float = 1
    offset: float = 0
    units: str = ""
    access: Rights | None = None
    minimum: float | None = None
    maximum: float | None = None
    description: str = ""
    read: Read = field(init=False, repr=False, compare=False)
    _scaling: Scaling | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, least, most in (
            ("name", 1, MAX_NAME),
            ("units", 0, MAX_UNITS),
            ("description", 0, MAX_DESCRIPTION),
        ):
            _check_text(name, getattr(self, name), least, most)
        for name in ("encoding", "padding"):
            _check_string(name, getattr(self, name))
        if self.type is None and not _is_bits(self.table):
            store(self, type="uint16")
        text = {"encoding": self.encoding, "padding": self.padding}
        read = Read(self.table, self.address, self.count, self.type, self.order, **text)
        order = "ABCD" if read.kind is None else read.kind.order
        store(self, read=read, address=read.address, count=read.count, order=order)
        store(self, access=self._checked_access(), _scaling=self._checked_scaling())
        self._check_bounds()

    # --- properties ----------------------------------------------------------------------

    @property
    def unit(self) -> str:
        """The old name of `units`."""
        warnings.warn("Point.unit is now Point.units", DeprecationWarning, stacklevel=2)
        return self.units

    @property
    def is_readable(self) -> bool:
        """True if clients may read the point."""
        return self.access != "write"

    @property
    def is_writable(self) -> bool:
        """True if clients may write the point."""
        return self.access != "read"

    @property
    def cells(self) -> range:
        """The addresses of all cells of the point."""
        return self.read.cells

    @property
    def to_value(self) -> Callable[[Any], Any] | None:
        """The function that converts a raw value to a scaled one; None where they are the same."""
        return None if self._scaling is None else self._scaling.to_value

    @property
    def type_name(self) -> str:
        """The type of the values; the name of the table where that holds bits."""
        return self.type or self.table

    @property
    def limits(self) -> tuple[float, float] | tuple[None, None]:
        """
        The lowest and the highest value that its cells can hold, scaled; 0 and 1 in tables of
        bits; None and None if its values are no numbers.
        """
        if self.read.kind is None:
            return 0, 1
        if self.read.kind.limits is None:
            return None, None
        low, high = self.read.kind.limits
        if self._scaling is None:
            return low, high
        low, high = sorted(map(self._scaling.to_value, (low, high)))
        return low, high

    @property
    def step(self) -> float:
        """The distance between two adjacent values; 0 for floats and where there are no numbers."""
        limits = (0, 1) if self.read.kind is None else self.read.kind.limits
        is_whole = limits is not None and isinstance(limits[0], int)
        return abs(self.scale) if is_whole else 0

    # --- cells and values ------------------------------------------------------------------

    def decode(self, cells: Sequence[Any]) -> Any:
        """
        Return the value that the cells of the point hold.

        Args:
            cells: True and False, or registers 0..65535: as many as `cells`.

        Returns:
            The value, scaled: an int, a float, True or False, a string, a list of bits;
            a list of such unless `count` is 1.

        Raises:
            TypeError, ValueError: the number of cells is wrong, or they hold no value of this
                    type; the message names the point.
        """
        try:
            if len(cells) != len(self.cells):
                raise WrongValue("cells", f"must be {len(self.cells)}, not {len(cells)}")
            values = self.values_in(cells)
        except (TypeError, ValueError) as error:
            # A plain error: readings of fleets have the name of its class as their reason.
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{self.name}: {error}") from None
        return values[0] if self.count == 1 else values

    def values_in(self, cells: Sequence[Any]) -> list[Any]:
        """
        Return the values that the cells of some values of the point hold.

        Raises:
            TypeError, ValueError: the cells hold no values of this type.
        """
        values = list(cells) if self.read.kind is None else self.read.kind.decode_many(cells)
        if self._scaling is None:
            return values
        return [self._scaling.to_value(raw) for raw in values]

    def encode(self, value: Any) -> list[Any]:
        """
        Return the cells of a value.

        A scaled value is rounded to the nearest raw integer, a tie to the even one: 21.57 at a
        scale of 0.1 is 216. Without scaling, the value of an integer type must be whole.

        Args:
            value: as `decode` returns it; numbers may be of any numeric type.

        Raises:
            TypeError, ValueError: the value does not fit the type, `count`, `minimum` or
                    `maximum`; the message names the point.
        """
        try:
            return self.cells_of(value)
        except (TypeError, ValueError) as error:
            raise _named(self.name, error) from None

    def cells_of(self, value: Any) -> list[Any]:
        """
        Return the cells of a value, as `encode` does.

        Raises:
            TypeError, ValueError: as `encode`; the message begins with "value", not with the
                name of the point.
        """
        given = [value] if self.count == 1 else self._checked_values(value)
        return [cell for each in given for cell in self.cells_of_one(each)]

    def cells_of_one(self, value: Any) -> list[Any]:
        """
        Return the cells of one of the values of the point.

        Raises:
            TypeError, ValueError: as `cells_of`.
        """
        cells = self._encoded(value)
        if self.minimum is not None or self.maximum is not None:
            self._check_bounds_of(value)
            if self._scaling is not None and self.step:
                # 0.25 at a scale of 0.1 is written as 0.2.
                self._check_bounds_of(self.values_in(cells)[0], value)
        return cells

    def cells_for(self, values: Iterable[Any]) -> list[Any]:
        """
        Return the cells of some of the values; `minimum` and `maximum` are not checked.

        Raises:
            TypeError, ValueError: a value does not fit the type; the message begins with "value".
        """
        return [cell for each in values for cell in self._encoded(each)]

    def _checked_values(self, values: object) -> Sequence[Any]:
        taken = checked_sequence("value", values, self.count)
        if len(taken) != self.count:
            raise WrongValue("value", f"must be a list of {self.count}, not of {len(taken)}")
        return taken

    def _encoded(self, value: Any) -> list[Any]:
        kind = self.read.kind
        if kind is None:
            return [checked_bit("value", value)]
        if self._scaling is None:
            return kind.encode(value)
        return kind.encode(self._raw(kind, self._scaling, value))

    def _raw(self, kind: ValueType, scaling: Scaling, value: object) -> float:
        if kind.limits is None or isinstance(kind.limits[0], float):
            return scaling.to_float(value)
        raw = scaling.to_whole(value)
        if not kind.limits[0] <= raw <= kind.limits[1]:
            raise WrongValue("value", f"must be in {_span(*self.limits)}, not {shown(value)}")
        return raw

    def _check_bounds_of(self, value: Any, given: Any = None) -> None:
        low, high = self.minimum, self.maximum
        if not _is_within(value, low, high):
            told = shown(value) if given is None else f"{shown(given)}, written as {shown(value)}"
            raise WrongValue("value", f"must be in {_span(low, high)}, not {told}")

    # --- checks ------------------------------------------------------------------------------

    def _checked_access(self) -> Rights:
        can_be_written = TABLES[self.table].most_written > 0
        if self.access is None:
            return "read_write" if can_be_written else "read"
        if self.access not in ACCESSES:
            given = reprlib.repr(self.access)
            raise WrongValue("access", f"must be one of {', '.join(ACCESSES)}, not {given}")
        if self.access != "read" and not can_be_written:
            raise WrongValue("access", f"must be read for {self.table}, not {self.access!r}")
        return self.access

    def _checked_scaling(self) -> Scaling | None:
        for name, plain in (("scale", 1), ("offset", 0)):
            if number(name, getattr(self, name)) != plain and not self._is_number:
                raise WrongValue(
                    name, f"must be {plain} for {self.type_name}, which has no numbers"
                )
        return None if self.scale == 1 and self.offset == 0 else Scaling(self.scale, self.offset)

    def _check_bounds(self) -> None:
        low, high = self.minimum, self.maximum
        for name, bound in (("minimum", low), ("maximum", high)):
            if bound is not None and not self._is_number:
                raise WrongValue(
                    name, f"must be left out for {self.type_name}, which has no numbers"
                )
            if bound is not None:
                number(name, bound)
        if low is not None and high is not None and low > high:
            raise WrongValue("minimum", f"must not be above maximum, {shown(high)}: {shown(low)}")

    @property
    def _is_number(self) -> bool:
        return self.read.kind is not None and self.read.kind.limits is not None


_init = Point.__init__


@functools.wraps(_init)
def _renaming(self: Point, *args: Any, **options: Any) -> None:
    if "unit" in options:
        warnings.warn("Point(unit=) is now Point(units=)", DeprecationWarning, stacklevel=2)
        options["units"] = options.pop("unit")
    _init(self, *args, **options)


Point.__init__ = _renaming  # type: ignore[method-assign]


def _is_bits(table: object) -> bool:
    """Return True for a table of bits; an unknown table is refused elsewhere."""
    return not isinstance(table, str) or table not in TABLES or TABLES[table].is_bits


def _check_string(name: str, value: object) -> None:
    if not isinstance(value, str):
        raise WrongType(name, f"must be a string, not {type(value).__name__}")


def _check_text(name: str, value: Any, least: int, most: int) -> None:
    _check_string(name, value)
    if not least <= len(value) <= most:
        raise WrongValue(name, f"must have {least}..{most} characters, not {len(value)}")
    unfit = [each for each in value if not each.isprintable() and each not in "\n\t"]
    if unfit or (name != "description" and value != value.strip()):
        raise WrongValue(
            name, f"must be printable characters, without spaces around: {reprlib.repr(value)}"
        )


def _is_within(value: Any, low: Any, high: Any) -> bool:
    """Return True if the bounds hold as they are written: Decimal("0.3") is not above 0.3."""
    if not isinstance(value, int | float):
        value, low, high = (each if each is None else exact(each) for each in (value, low, high))
    return (low is None or value >= low) and (high is None or value <= high)


def _span(low: float | None, high: float | None) -> str:
    return f"{'' if low is None else low}..{'' if high is None else high}"


def _named(name: str, error: Exception) -> Mistake:
    """Return an error that begins with the name of a point."""
    kind = WrongType if isinstance(error, TypeError) else WrongValue
    return kind.about(name, str(error))
