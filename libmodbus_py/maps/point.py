"""One named value of a device: its location and the meaning of its cells."""

from __future__ import annotations

import keyword
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count
from typing import Any, Literal

from ..protocol.checks import shown
from ..protocol.mistakes import WrongType, WrongValue, named_arguments
from ..protocol.pdu.request import checked_sequence
from ..protocol.tables import Table
from ..protocol.values import Order, TypeName
from .items import Read
from .meaning import CellChange, DecodedValue, Meaning, NoValue
from .point_checks import check_point
from .scaling import Scaling, exact, scaling_by

Rights = Literal["read", "write", "read_write"]


@named_arguments
@dataclass(frozen=True)
class Point:
    """
    One named value of a device, or several values of one kind.

    Args:
        name: the name, 1..100 printable characters, unique in its map.
        table: "coils", "discrete_inputs", "holding_registers" or "input_registers".
        address: the address of its first cell, 0..65535.
        count: the number of values; 1 for a single value, more for a list of values.
        type: the type of the values in registers, such as "float32" (`libmodbus_py.values`);
            uint16 if it is not given; None in tables of bits, whose values are True and False.
        order, encoding, padding: the layout of the type, as for `values.value_type`.
        scale, offset: for numbers, value = raw * scale + offset, computed with the decimal
            numbers as they are written: 2305 times 0.1 is 230.5. Integers stay integers if both
            are whole. Each is -1e30..1e30, and the scale is not nearer to 0 than 1e-30.
        units: the units of the value, such as "V" or "kWh", up to 100 characters.
        access: what clients may do: "read", "write" or "read_write". If it is not given,
            "read" for discrete inputs and input registers, and "read_write" for others.
        minimum, maximum: the lowest and the highest scaled value that may be written; None for
            no bound besides that of the type.
        description: a description, up to 2000 characters.
        missing: raw values that mean that there is no value: a number, a list of numbers, or
            "sunspec" for the values that mean "not implemented" in SunSpec, such as 0x8000 of an
            int16, 65535 of a uint16, or a string of zeros only. A nan always means that.
        plausible_minimum, plausible_maximum: the lowest and the highest scaled value that is
            accepted when it is read; beyond them there is no value.
        never_falls: True for a total, which should never decrease. If it does, a fleet reads it
            again at the next poll before it reports it, with the reason "Fell".
        scale_from: the name of a point of the same map whose value is another factor:
            value = raw * scale * factor + offset.
        scale_as: what that point holds: "exponent" for a power of ten, -30..30, or "factor".
        states: names of numbers, such as {0: "off", 1: "on", "2..9": "fault", "else": "?"}; of
            ranges, which may be open, as in "10..", and of all other numbers. The value is the
            name; a number without a name stays a number. Several numbers may have one name, which
            cannot be written then.
        bits: names of bits, such as {0: "door", "4..7": "mode"}; bit 0 is the lowest. The value
            is a dict with True or False for one bit, and a number for several bits.
        bit: the bit that is the value, True or False; or several bits, such as "4..7", whose
            value is a number. Writing the point does not change other bits of the registers.
        byte: "high" or "low": the byte of the register that is the value.
        time_zone: for types of times, the time zone whose local time the device shows, such as
            "Europe/Berlin"; values are always in UTC. If a local time occurs twice because
            summer time ends, the first one is assumed, unless the type is iec870, which tells them
            apart. If a local time does not exist, there is no value.
        interval: the seconds between two reads of the point in `watch`, ``read --watch`` and
            fleets, 0.01..86400, in place of the interval of the other points; None for that
            one. The point is read at the first poll after the interval, never earlier.
        border: True if no request may ask for cells before the point together with its own,
            because the device refuses that.
        group: the name of a group of points that can be selected together, up to 100 characters.
        rewrite: the seconds after which a fleet writes the last value that it wrote again, and
            again, 0.01..86400, for devices that need it; None for never.
        initial: the value with which a simulated device begins, as `encode` takes it.
        write_function: the functions that write the point: "single" for 5 and 6, "multiple" for 15
            and 16; None for those of the client, or of the device of a fleet.

    Attributes:
        read: the `Read` of all cells, for a `Plan`.
        meaning: the conversion of cells to values and back.

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
    missing: float | Sequence[float] | Literal["sunspec"] | None = None
    plausible_minimum: float | None = None
    plausible_maximum: float | None = None
    never_falls: bool = False
    scale_from: str | None = None
    scale_as: Literal["exponent", "factor"] = "exponent"
    states: Mapping[Any, str] | None = field(default=None, hash=False)
    bits: Mapping[int | str, str] | None = field(default=None, hash=False)
    bit: int | str | None = None
    byte: Literal["high", "low"] | None = None
    time_zone: str = "UTC"
    interval: float | None = None
    border: bool = False
    group: str = ""
    rewrite: float | None = None
    initial: Any = None
    write_function: Literal["single", "multiple"] | None = None
    read: Read = field(init=False, repr=False, compare=False)
    meaning: Meaning = field(init=False, repr=False, compare=False)
    _scaling: Scaling | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_point(self)

    # --- properties ----------------------------------------------------------------------

    @property
    def is_readable(self) -> bool:
        """True if clients may read the point."""
        return self.access != "write"

    @property
    def is_writable(self) -> bool:
        """True if clients may write the point."""
        return self.access != "read"

    @property
    def has_bounds(self) -> bool:
        """True if the point has a minimum or a maximum."""
        return self.minimum is not None or self.maximum is not None

    @property
    def is_part(self) -> bool:
        """True if the point is a part of its registers: writing leaves the other bits alone."""
        return self.meaning.is_part

    @property
    def cells(self) -> range:
        """The addresses of all cells of the point."""
        return self.read.cells

    @property
    def to_value(self) -> Callable[[Any], Any] | None:
        """
        The function that converts a raw value to a scaled one; None if both are equal.

        The factor of `scale_from` is not in it.
        """
        return None if self._scaling is None else self._scaling.to_value

    @property
    def type_name(self) -> str:
        """The type of the values; the name of the table where that holds bits."""
        return self.type or self.table

    @property
    def limits(self) -> tuple[float, float] | tuple[None, None]:
        """
        The lowest and the highest value that its cells can hold, scaled; 0 and 1 in tables of
        bits; None and None if its values are not numbers, or `scale_from` scales them.
        """
        if self.read.kind is None and self.states is None:
            return 0, 1
        if not self.meaning.has_numbers or self.scale_from is not None:
            return None, None
        low, high = self.meaning.limits
        if self._scaling is not None:
            low, high = sorted(map(self._scaling.to_value, (low, high)))
        return low, high

    @property
    def step(self) -> float:
        """The distance between two adjacent values; 0 for floats and where there are no numbers."""
        if self.read.kind is not None and not self.meaning.has_numbers:
            return 0
        return abs(self.scale) if isinstance(self.meaning.limits[0], int) else 0

    # --- values of cells -------------------------------------------------------------------

    def decode(self, cells: Sequence[Any], *, source: float | None = None) -> Any:
        """
        Return the value that the cells of the point hold.

        Args:
            cells: True and False, or registers 0..65535: as many as `cells`.
            source: the value of the point that `scale_from` names.

        Returns:
            The scaled value: an int, a float, True or False, a string, a datetime, a list of
            bits, the name of a state, or a dict of named bits; None if the cells hold no value or
            `source` is not a scale, for which `judge` returns the reason. If `count` is not 1, a
            list of such values.

        Raises:
            TypeError, ValueError: the cells are wrong in number or type; the message names the
                point.
        """
        return self.judge(cells, source=source).value

    def judge(self, cells: Sequence[Any], *, source: float | None = None) -> DecodedValue:
        """Return the value that the cells hold, or the reason why there is none; as `decode`."""
        try:
            if len(cells) != len(self.cells):
                raise WrongValue("cells", f"must have {len(self.cells)} items, not {len(cells)}")
            try:
                scaling = self.scaling_for(source)
            except NoValue as none:
                return DecodedValue.of([none] * self.count, is_list=self.count > 1)
            results = self.meaning.values_in(cells, scaling)
        except (TypeError, ValueError) as error:
            # A plain error: readings of fleets have the name of its class as their reason.
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{self.name}: {error}") from None
        return DecodedValue.of(results, is_list=self.count > 1)

    def scaling_for(self, source: object) -> Scaling | None:
        """Return the scaling, None without one; or raise NoValue for an invalid scale."""
        if self.scale_from is None:
            return self._scaling
        try:
            if isinstance(source, bool) or not isinstance(source, int | float):
                raise ValueError("a number, but has no value")
            return scaling_by(self.scale, self.offset, self.scale_as, source)
        except ValueError as error:
            text = f"has no value: {self.scale_from}, which scales it, must hold {error}"
            raise NoValue(self.name, "BadScale", text) from None

    def values_in(self, cells: Sequence[Any], scaling: Scaling | None = None) -> list[Any]:
        """Return the values that some of the cells hold; None stands for no value."""
        results = self.meaning.values_in(cells, scaling or self._scaling)
        return [None if isinstance(result, NoValue) else result for result in results]

    # --- cells of values -------------------------------------------------------------------

    def encode(self, value: Any, *, source: float | None = None) -> list[Any]:
        """
        Return the cells of a value.

        A scaled value is rounded to the nearest raw integer, a tie to the even one: 21.57 at a
        scale of 0.1 is 216. Without scaling, the value of an integer type must be whole. Bits
        of the registers that are not part of the point are 0.

        Args:
            value: as `decode` returns it; numbers may be of any numeric type, a state may be
                its name or its number.
            source: the value of the point that `scale_from` names.

        Raises:
            TypeError, ValueError: the value does not fit the type, `count`, `minimum` or
                `maximum`; the message names the point.
            NoValue: `source` is not a scale.
        """
        return self.change(value, source=source).cells

    def change(self, value: Any, *, source: float | None = None) -> CellChange:
        """
        Return what writing a value changes: all bits of the cells, or those of a part.

        Args:
            value, source: as for `encode`.

        Raises:
            TypeError, ValueError: as `encode`.
        """
        scaling = self.scaling_for(source)
        try:
            return self._change(value, scaling)
        except (TypeError, ValueError) as error:
            kind = WrongType if isinstance(error, TypeError) else WrongValue
            raise kind.about(self.name, str(error)) from None

    def cells_for(self, values: Iterable[Any]) -> list[Any]:
        """Return the cells of some of the values; `minimum` and `maximum` are not checked."""
        changes = [self.meaning.change(value, self._scaling) for value in values]
        return [cell for value in changes for cell in value.cells]

    def _change(self, value: Any, scaling: Scaling | None) -> CellChange:
        if self.count == 1:
            return self._change_of_one(value, scaling)
        values = checked_sequence("value", value, self.count)
        if len(values) != self.count:
            raise WrongValue("value", f"must be a list of {self.count}, not of {len(values)}")
        changes = [self._change_of_one(change, scaling) for change in values]
        masks = [mask for change in changes for mask in change.masks or ()]
        return CellChange([cell for change in changes for cell in change.cells], masks or None)

    def _change_of_one(self, value: Any, scaling: Scaling | None) -> CellChange:
        scaling = scaling or self._scaling
        change = self.meaning.change(value, scaling)
        if self.has_bounds:
            self.check_bounds(value)
            if scaling is not None and self.step:
                # 0.25 at a scale of 0.1 is written as 0.2.
                (raw,) = self.meaning.raws_in(change.cells)
                self.check_bounds(scaling.to_value(raw), value)
        return change

    def check_bounds(self, value: Any, written_value: Any = None) -> None:
        """Check a value, that was rounded from the one given, against `minimum` and `maximum`."""
        low, high = self.minimum, self.maximum
        if not _is_within(value, low, high):
            span = f"{'' if low is None else low}..{'' if high is None else high}"
            text = "" if written_value is None else f"{shown(written_value)}, written as "
            raise WrongValue("value", f"must be in {span}, not {text}{shown(value)}")


def _is_within(value: Any, low: Any, high: Any) -> bool:
    """Return True if a value is within the bounds as written: Decimal("0.3") is not above 0.3."""
    if not isinstance(value, int | float):
        value, low, high = (item if item is None else exact(item) for item in (value, low, high))
    return (low is None or value >= low) and (high is None or value <= high)


# --- names of points as attributes ----------------------------------------------------------------

RESERVED = frozenset(
    {
        *("bind", "client", "datetime", "map", "read", "self", "write"),
        *("bool", "dict", "float", "int", "list", "property", "str", "super"),
    }
)
"""Names that no attribute may have, because bound maps and their classes use them."""


def attribute_names(names: Iterable[str]) -> dict[str, str]:
    """Return the attribute for the name of each point, by the rules of `BoundMap`."""
    names = list(names)
    attributes = {name: name for name in names if _identifier(name) == name}
    others = {*attributes}
    for name in names:
        if name not in attributes:
            attributes[name] = _free(_identifier(name), others)
            others.add(attributes[name])
    return {name: attributes[name] for name in names}


def _identifier(name: str) -> str:
    text = spelled(name).strip("_") or "point"
    if not text.isidentifier():
        text = f"point_{text}"
    return f"{text}_" if keyword.iskeyword(text) or text in RESERVED else text


def spelled(name: str) -> str:
    """Return a name with one ``_`` for each run of characters that no identifier has."""
    # As Python itself spells identifiers; twice, because some letters become others and a space.
    text = unicodedata.normalize("NFKC", name)
    text = "".join(letter if f"a{letter}".isidentifier() else " " for letter in text)
    return unicodedata.normalize("NFKC", re.sub(" +", "_", text))


def _free(text: str, attributes: set[str]) -> str:
    others = (f"{text}_{number}" for number in count(2))
    return next(name for name in chain([text], others) if name not in attributes)
