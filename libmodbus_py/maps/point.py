"""
One named value of a device: its location and the meaning of its cells.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from ..protocol.checks import are_registers, seconds, shown
from ..protocol.close_names import named_arguments
from ..protocol.mistakes import Mistake, WrongType, WrongValue
from ..protocol.pdu.fields import checked_bit, checked_sequence, store
from ..protocol.tables import TABLES, Table, checked_table
from ..protocol.values import Order, TypeName, ValueType
from .meaning import Judged, Meaning, NoValue
from .meaning_keys import checked_meaning, has_numbers, tidied
from .plan import Read
from .scaling import Scaling, exact, number, scaling_by

# fmt: off
__all__ = [
    "ACCESSES", "LONGEST_INTERVAL", "MAX_DESCRIPTION", "SHORTEST_INTERVAL", "Point", "Rights",
]
# fmt: on

Rights = Literal["read", "write", "read_write"]

ACCESSES = ("read", "write", "read_write")

# Seconds; a longer interval is taken to be a mistake.
SHORTEST_INTERVAL, LONGEST_INTERVAL = 0.01, 86_400.0

MAX_NAME, MAX_UNITS, MAX_DESCRIPTION = 100, 50, 2000


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
        units: the units of the value, such as "V" or "kWh", up to 50 characters.
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
        states: names of whole numbers, such as {0: "off", 1: "on"}. The value is the name;
            a number without a name stays a number.
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
        group: the name of a group of points that can be selected together, up to 100 characters.

    Attributes:
        read: the `Read` of all cells, for a `Plan`.
        meaning: the conversion of raw values for which scale and offset are not enough, or None.

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
    states: Mapping[int, str] | None = field(default=None, hash=False)
    bits: Mapping[int | str, str] | None = field(default=None, hash=False)
    bit: int | str | None = None
    byte: Literal["high", "low"] | None = None
    time_zone: str = "UTC"
    interval: float | None = None
    group: str = ""
    read: Read = field(init=False, repr=False, compare=False)
    _scaling: Scaling | None = field(init=False, repr=False, compare=False)
    meaning: Meaning | None = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for name, least, most in (
            ("name", 1, MAX_NAME),
            ("units", 0, MAX_UNITS),
            ("group", 0, MAX_NAME),
            ("description", 0, MAX_DESCRIPTION),
        ):
            _check_text(name, getattr(self, name), least, most)
        for name in ("encoding", "padding"):
            _check_string(name, getattr(self, name))
        if not isinstance(self.table, str) or self.table not in TABLES:
            store(self, table=checked_table(self.table))
        if self.type is None and not TABLES[self.table].is_bits:
            store(self, type="uint16")
        text = {"encoding": self.encoding, "padding": self.padding}
        read = Read(self.table, self.address, self.count, self.type, self.order, **text)
        order = "ABCD" if read.kind is None else read.kind.order
        store(self, read=read, address=read.address, count=read.count, order=order)
        store(self, type=read.type)
        if self.time_zone != "UTC":
            store(read, kind=_local(read.kind, self))
        if self.interval is not None:
            seconds("interval", self.interval, SHORTEST_INTERVAL, LONGEST_INTERVAL)
        store(self, **tidied(self))
        store(self, access=self._checked_access(), meaning=checked_meaning(self))
        store(self, _scaling=self._checked_scaling())
        self._check_bounds()

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
    def cells(self) -> range:
        """The addresses of all cells of the point."""
        return self.read.cells

    @property
    def to_value(self) -> Callable[[Any], Any] | None:
        """
        The function that converts a raw value to a scaled one; None where they are the same.

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
        if not has_numbers(self) or self.scale_from is not None:
            return None, None
        low, high = self._raw_limits
        if self._scaling is None:
            return low, high
        low, high = sorted(map(self._scaling.to_value, (low, high)))
        return low, high

    @property
    def step(self) -> float:
        """The distance between two adjacent values; 0 for floats and where there are no numbers."""
        if self.read.kind is not None and not has_numbers(self):
            return 0
        return abs(self.scale) if isinstance(self._raw_limits[0], int) else 0

    @property
    def _raw_limits(self) -> tuple[float, float]:
        part = None if self.meaning is None else self.meaning.part
        if part is not None:
            return part.limits
        kind = self.read.kind
        return (0, 1) if kind is None or kind.limits is None else kind.limits

    # --- cells and values ------------------------------------------------------------------

    def decode(self, cells: Sequence[Any], *, source: float | None = None) -> Any:
        """
        Return the value that the cells of the point hold.

        Args:
            cells: True and False, or registers 0..65535: as many as `cells`.
            source: the value of the point that `scale_from` names.

        Returns:
            The scaled value: an int, a float, True or False, a string, a datetime, a list of
            bits, the name of a state, or a dict of named bits; None if there is no value or
            `source` is not a scale, for which `judge` returns the reason. If `count` is not 1, a
            list of such values.

        Raises:
            TypeError, ValueError: the number of cells is wrong, or they hold no value of this
                type; the message names the point.
        """
        return self.judge(cells, source=source).value

    def judge(self, cells: Sequence[Any], *, source: float | None = None) -> Judged:
        """
        Return the value that the cells of the point hold, or the reason why there is none.

        Args:
            cells, source: as for `decode`.

        Raises:
            TypeError, ValueError: as `decode`.
        """
        try:
            if len(cells) != len(self.cells):
                raise WrongValue("cells", f"must be {len(self.cells)}, not {len(cells)}")
            try:
                scaling = self.scaling_for(source)
            except NoValue as none:
                return Judged.of([none] * self.count, is_list=self.count > 1)
            found = self.found_in(cells, None if scaling is None else scaling.to_value)
        except (TypeError, ValueError) as error:
            # A plain error: readings of fleets have the name of its class as their reason.
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(f"{self.name}: {error}") from None
        return Judged.of(found, is_list=self.count > 1)

    def scaling_for(self, source: object) -> Scaling | None:
        """
        Return the scaling of the point; None if raw values are the values.

        Args:
            source: the value of the point that `scale_from` names; None if it has none.

        Raises:
            NoValue: it is not a scale.
        """
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
        """
        Return the values that the cells of some values of the point hold.

        None stands for no value.

        Args:
            scaling: that of `scaling_for`; None for the scale and offset of the point.

        Raises:
            TypeError, ValueError: the cells hold no values of this type.
        """
        scaling = scaling or self._scaling
        found = self.found_in(cells, None if scaling is None else scaling.to_value)
        return [None if isinstance(each, NoValue) else each for each in found]

    def found_in(self, cells: Sequence[Any], scale: Callable[[Any], Any] | None) -> list[Any]:
        """
        Return the values that cells hold; a `NoValue` stands for no value.

        Args:
            scale: converts raw numbers to scaled ones; None if they are the same.

        Raises:
            TypeError, ValueError: the cells hold no values of this type.
        """
        raws = self._raws_in(cells)
        if self.meaning is not None:
            judge = self.meaning.judge
            return [raw if isinstance(raw, NoValue) else judge(raw, scale) for raw in raws]
        if scale is not None:
            raws = [scale(raw) for raw in raws]
        return [self.nan() if raw != raw else raw for raw in raws]

    def nan(self) -> NoValue:
        """Return the reason why a nan is not a value."""
        return NoValue(self.name, "Missing", "has no value: the device says nan")

    def _raws_in(self, cells: Sequence[Any]) -> list[Any]:
        kind = self.read.kind
        if kind is None:
            return list(cells)
        from_bytes = kind.from_bytes if self.meaning is None else self.meaning.from_bytes
        if kind.is_time:
            return [self._time_of(kind, one) for one in _groups(cells, kind.registers)]
        if from_bytes == kind.from_bytes:
            return kind.decode_many(cells)
        return [from_bytes(_packed(kind, one)) for one in _groups(cells, kind.registers)]

    def _time_of(self, kind: ValueType, cells: Sequence[int]) -> Any:
        data = _packed(kind, cells)
        try:
            return kind.from_bytes(data)
        except ValueError as error:
            return NoValue(self.name, "InvalidTime", f"has no value: {error}")

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
        try:
            return self.cells_of(value, self.scaling_for(source))
        except NoValue:
            raise
        except (TypeError, ValueError) as error:
            raise _named(self.name, error) from None

    def cells_of(self, value: Any, scaling: Scaling | None = None) -> list[Any]:
        """
        Return the cells of a value, as `encode` does.

        Args:
            scaling: that of `scaling_for`; None for the scale and offset of the point.

        Raises:
            TypeError, ValueError: as `encode`; the message begins with "value", not with the
                name of the point.
        """
        given = [value] if self.count == 1 else self._checked_values(value)
        return [cell for each in given for cell in self.cells_of_one(each, scaling)]

    def cells_of_one(self, value: Any, scaling: Scaling | None = None) -> list[Any]:
        """
        Return the cells of one of the values of the point.

        Raises:
            TypeError, ValueError: as `cells_of`.
        """
        scaling = scaling or self._scaling
        cells = self._encoded(value, scaling)
        if self.minimum is not None or self.maximum is not None:
            self._check_bounds_of(value)
            if scaling is not None and self.step:
                # 0.25 at a scale of 0.1 is written as 0.2.
                self._check_bounds_of(scaling.to_value(self._raws_in(cells)[0]), value)
        return cells

    def masks_of(self, value: Any, source: float | None = None) -> list[tuple[int, int]]:
        """
        Return what a value changes in each register: the bits to set, and the bits it changes.

        For points that are parts of registers (`is_part`).

        Args:
            value, source: as for `encode`.

        Raises:
            TypeError, ValueError: as `encode`.
        """
        self.encode(value, source=source)  # which names the point in errors, and checks the bounds
        kind, meaning, scaling = self.read.kind, self.meaning, self.scaling_for(source)
        assert kind is not None
        assert meaning is not None
        found: list[tuple[int, int]] = []
        for each in [value] if self.count == 1 else self._checked_values(value):
            bits, mask = meaning.bits_of(self._raw_of(each, scaling))
            found += zip(kind.cells_of_number(bits), kind.cells_of_number(mask), strict=True)
        return found

    def put(self, before: Sequence[Any], value: Any, *, source: float | None = None) -> list[Any]:
        """
        Return the cells of a value, where bits that are not part of the point stay as before.

        Args:
            before: the cells that the point has.
            value, source: as for `encode`.

        Raises:
            TypeError, ValueError: as `encode`.
        """
        if not self.is_part:
            return self.encode(value, source=source)
        pairs = zip(before, self.masks_of(value, source), strict=True)
        return [int(cell) & ~mask | bits for cell, (bits, mask) in pairs]

    @property
    def is_part(self) -> bool:
        """True if the point is a part of its registers: writing leaves the other bits alone."""
        return self.meaning is not None and self.meaning.is_part

    def cells_for(self, values: Iterable[Any]) -> list[Any]:
        """
        Return the cells of some of the values; `minimum` and `maximum` are not checked.

        Raises:
            TypeError, ValueError: a value does not fit the type; the message begins with "value".
        """
        return [cell for each in values for cell in self._encoded(each, self._scaling)]

    def _checked_values(self, values: object) -> Sequence[Any]:
        taken = checked_sequence("value", values, self.count)
        if len(taken) != self.count:
            raise WrongValue("value", f"must be a list of {self.count}, not of {len(taken)}")
        return taken

    def _encoded(self, value: Any, scaling: Scaling | None) -> list[Any]:
        kind, raw = self.read.kind, self._raw_of(value, scaling)
        if kind is None:
            return [checked_bit("value", raw)]
        if self.meaning is not None and self.meaning.is_part:
            return kind.cells_of_number(self.meaning.bits_of(raw)[0])
        return kind.encode(raw)

    def _raw_of(self, value: Any, scaling: Scaling | None) -> Any:
        raw = value if self.meaning is None else self.meaning.number_of(value)
        return raw if scaling is None else self._raw(scaling, raw)

    def _raw(self, scaling: Scaling, value: object) -> float:
        low, high = self._raw_limits
        if isinstance(low, float):
            return scaling.to_float(value)
        raw = scaling.to_whole(value)
        if not low <= raw <= high:
            span = sorted(map(scaling.to_value, (low, high)))
            raise WrongValue("value", f"must be in {_span(*span)}, not {shown(value)}")
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
        for name in ("scale", "offset"):
            number(name, getattr(self, name))
        return None if self.scale == 1 and self.offset == 0 else Scaling(self.scale, self.offset)

    def _check_bounds(self) -> None:
        low, high = self.minimum, self.maximum
        for name, bound in (("minimum", low), ("maximum", high)):
            if bound is not None:
                number(name, bound)
        if low is not None and high is not None and low > high:
            raise WrongValue("minimum", f"must not be above maximum, {shown(high)}: {shown(low)}")


def _local(kind: ValueType | None, point: Point) -> ValueType:
    """Return the type of a point whose registers hold the local time of a zone."""
    from ..protocol.local_times import checked_time_zone, in_time_zone  # which few programs need

    zone = checked_time_zone("time_zone", point.time_zone)
    if kind is None or not kind.is_time:
        reason = f"must be left out for {point.type_name}, which is not a time"
        raise WrongValue("time_zone", reason)
    return in_time_zone(kind, zone)


def _groups(cells: Sequence[int], size: int) -> list[Sequence[int]]:
    return [cells[at : at + size] for at in range(0, len(cells), size)]


def _packed(kind: ValueType, cells: Sequence[int]) -> bytes:
    if len(cells) != kind.registers or not are_registers(cells):
        kind.decode(cells)  # raises the error that says what is wrong
    return struct.pack(f">{len(cells)}H", *cells)


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
