"""The meaning of the cells of a value: numbers, states, bits, parts of registers, or no value."""

from __future__ import annotations

import math
import re
import reprlib
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from ..protocol.checks import are_registers, instance, integer, shown
from ..protocol.errors import ModbusError
from ..protocol.mistakes import Path, WrongType, WrongValue
from ..protocol.pdu.request import checked_bit
from ..protocol.plain import SHORT_FLOATS, shortest
from ..protocol.values import ValueType
from .scaling import Scaling, States

Reason = Literal["Missing", "Implausible", "InvalidData", "InvalidTime", "BadScale"]


class NoValue(ModbusError, ValueError):
    """
    The registers of a point hold no value; the message says why.

    Args:
        name: the name of the point; without a map, its place, such as "input_registers 100".
        reason: "Missing" if the device reports that there is no value, "Implausible" if the value
            is below `plausible_minimum` or above `plausible_maximum`, "InvalidTime" if the
            registers hold no valid time, "InvalidData" if they hold no value of another type, such
            as text that is not in its encoding or BCD with a digit above 9, "BadScale" if the
            point named by `scale_from` holds no scale.
        text: the reason as a sentence about the point.

    Attributes:
        name, reason: as given.
    """

    def __init__(self, name: str, reason: Reason, text: str) -> None:
        Exception.__init__(self, name, reason, text)  # a poll may make thousands
        self.name: str = name
        self.reason: Reason = reason

    def __repr__(self) -> str:
        return Exception.__repr__(self)

    def __str__(self) -> str:
        return f"{self.name} {self.args[2]}"


def no_value(name: str, kind: ValueType, error: ValueError) -> NoValue:
    """Return why registers hold no value of a type."""
    reason: Reason = "InvalidTime" if kind.is_time else "InvalidData"
    return NoValue(name, reason, f"has no value: {error}")


class DecodedValue(NamedTuple):
    """
    A value, as `Point.decode` returns it, or the reason of `NoValue` why there is none; of a list,
    the reason of the first item that is None.
    """

    value: Any
    quality: Literal["good", "bad"] = "good"
    reason: Reason | Literal[""] = ""

    @classmethod
    def of(cls, results: Sequence[Any], *, is_list: bool) -> DecodedValue:
        """Return the values that were found in a point, where `NoValue` stands for none."""
        bad = [result for result in results if isinstance(result, NoValue)]
        if not is_list:
            return cls(None, "bad", bad[0].reason) if bad else cls(results[0])
        values = [None if isinstance(result, NoValue) else result for result in results]
        quality: Literal["good", "bad"] = "bad" if len(bad) == len(results) else "good"
        return cls(values, quality, bad[0].reason if bad else "")


# --- parts of registers -----------------------------------------------------------------

_SPAN = re.compile(r"\s*([0-9]{1,3})\s*(?:\.\.\s*([0-9]{1,3})\s*)?", re.ASCII)


class Part(NamedTuple):
    """Adjacent bits of a value, from `shift` on: True or False for a flag, else a number."""

    shift: int
    width: int
    is_flag: bool = False
    is_signed: bool = False

    @property
    def key(self) -> int | str:
        """The part as `part_of` takes it."""
        return self.shift if self.is_flag else f"{self.shift}..{self.shift + self.width - 1}"

    @property
    def mask(self) -> int:
        """The bits of the part, as a number of all bits."""
        return (1 << self.width) - 1 << self.shift

    @property
    def limits(self) -> tuple[int, int]:
        """The lowest and the highest number."""
        if self.is_signed:
            return -1 << self.width - 1, (1 << self.width - 1) - 1
        return 0, (1 << self.width) - 1

    def of(self, number: int) -> int:
        """Return the part of a number; True or False for a flag."""
        value = (number & self.mask) >> self.shift
        if self.is_flag:
            return bool(value)
        return value - (1 << self.width) if self.is_signed and value >> self.width - 1 else value

    def put(self, name: str | Path, value: object) -> int:
        """Return the bits of a value, all others 0, or raise TypeError or ValueError."""
        if self.is_flag and isinstance(value, bool):
            value = int(value)
        return integer(name, value, *self.limits) << self.shift & self.mask


def part_of(path: str | Path, text: object, bits: int, *, is_signed: bool = False) -> Part:
    """Return the part that a number such as 3 or a text such as "4..7" names, or raise an error."""
    if isinstance(text, int) and not isinstance(text, bool):
        return Part(integer(path, text, 0, bits - 1), 1, is_flag=True)
    if not isinstance(text, str):
        raise WrongType(path, f"must be a bit such as 3, or bits such as '4..7', not {text!r}")
    match = _SPAN.fullmatch(text)
    if match is None:
        form = "a bit such as 3, or bits such as '4..7'"
        raise WrongValue(path, f"must be {form}, not {reprlib.repr(text)}")
    if match[2] is None:
        return part_of(path, int(match[1]), bits)
    first, last = int(match[1]), int(match[2])
    if not first <= last < bits:
        form = f"within 0..{bits - 1}, the lower number first"
        raise WrongValue(path, f"must be {form}, not {reprlib.repr(text)}")
    return Part(first, last - first + 1, is_signed=is_signed)


# --- values -----------------------------------------------------------------------------


class CellChange(NamedTuple):
    """The new cells of a point, and the bits of each that change; None if all do."""

    cells: list[Any]
    masks: list[int] | None

    def over(self, before: Sequence[Any]) -> list[Any]:
        """Return the cells after the change, where bits that do not change stay as before."""
        if self.masks is None:
            return self.cells
        triples = zip(before, self.cells, self.masks, strict=True)
        return [int(old) & ~mask | bits for old, bits, mask in triples]


class Meaning:
    """
    Turns the cells of a point into values or `NoValue`, and values into cells.

    `from_bytes` returns the raw value of the bytes of one value; `is_plain`: every raw number is a
    value, but for nan.
    """

    __slots__ = (
        *("_is_list", "_kind", "_missing", "_name", "_span", "_states"),
        *("bits", "from_bytes", "has_numbers", "is_plain", "part"),
    )

    def __init__(
        self,
        name: str,
        kind: ValueType | None,
        *,
        missing: frozenset[Any],
        span: tuple[float, float] | None,
        part: Part | None,
        states: States | None,
        bits: Mapping[str, Part],
    ) -> None:
        self._name, self._kind = name, kind
        self._missing, self._span = missing, span
        self._states = states
        self._is_list = kind is not None and kind.name.startswith("bits") and not (part or bits)
        self.part: Part | None = part
        self.bits: Mapping[str, Part] = bits
        has_names = states is not None or bool(bits)
        self.is_plain: bool = not (part or span or missing or has_names)
        is_number = not part.is_flag if part else kind is not None and kind.limits is not None
        self.has_numbers: bool = is_number and not has_names
        self.from_bytes: Callable[[bytes], Any] = bool if kind is None else self._reader(kind)

    def _reader(self, kind: ValueType) -> Callable[[bytes], Any]:
        if self.part is not None:
            to_number, of = kind.to_number, self.part.of
            return lambda data: of(to_number(data))
        if kind.name not in SHORT_FLOATS:
            return kind.to_number if self.bits else kind.reader
        read, name = kind.reader, kind.name
        return lambda data: shortest(read(data), name)

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest raw number; 0 and 1 if raw values are none."""
        if self.part is not None:
            return self.part.limits
        return (0, 1) if self._kind is None or self._kind.limits is None else self._kind.limits

    @property
    def mask(self) -> int:
        """The bits of the registers that writing changes, if not all."""
        parts = self.bits.values() if self.part is None else [self.part]
        return sum(part.mask for part in parts)

    @property
    def is_part(self) -> bool:
        """True if writing changes some bits of the registers only."""
        return self.part is not None or bool(self.bits)

    # --- read ------------------------------------------------------------------------------

    def values_in(self, cells: Sequence[Any], scaling: Scaling | None) -> list[Any]:
        """Return the values that cells hold; a `NoValue` stands for none."""
        scale = None if scaling is None else scaling.to_value
        raws = self.raws_in(cells)
        return [raw if isinstance(raw, NoValue) else self.judge(raw, scale) for raw in raws]

    def raws_in(self, cells: Sequence[Any]) -> list[Any]:
        """Return the raw values that cells hold; a `NoValue` stands for data that is none."""
        if (kind := self._kind) is None:
            return list(cells)
        size = kind.registers
        if len(cells) % size or not are_registers(cells):
            kind.decode_many(cells)  # raises the error that says what is wrong
        data = struct.pack(f">{len(cells)}H", *cells)
        return [self._raw(data[at : at + 2 * size], kind) for at in range(0, len(data), 2 * size)]

    def _raw(self, data: bytes, kind: ValueType) -> Any:
        try:
            return self.from_bytes(data)
        except ValueError as error:
            bits = kind.to_number(data)
            if bits in self._missing:
                return self._missed(f"0x{bits:0{2 * len(data)}X}")
            return no_value(self._name, kind, error)

    def judge(self, raw: Any, scale: Callable[[Any], Any] | None) -> Any:
        """Return the value of a raw value, or a `NoValue`; `scale` converts numbers."""
        key = sum(bit << at for at, bit in enumerate(raw)) if self._is_list else raw
        if key in self._missing:
            return self._missed(key)
        if self.bits:
            return {name: part.of(raw) for name, part in self.bits.items()}
        if (states := self._states) is not None and raw == raw:
            return states.get(raw, raw) if states.is_simple else states[raw]
        value = raw if scale is None else scale(raw)
        if value != value:  # only nan differs from itself
            return self._missed(value)
        if self._span is None or self._span[0] <= value <= self._span[1]:
            return value
        span = "..".join("" if math.isinf(bound) else str(bound) for bound in self._span)
        text = f"is {shown(value)}, and plausible is {span}"
        return NoValue(self._name, "Implausible", text)

    def _missed(self, raw: object) -> NoValue:
        return NoValue(self._name, "Missing", f"has no value: the device says {shown(raw)}")

    # --- write -----------------------------------------------------------------------------

    def change(self, value: Any, scaling: Scaling | None) -> CellChange:
        """Return the changed cells of a value; errors begin with "value"."""
        kind, raw = self._kind, self._raw_of(value, scaling)
        if kind is None:
            return CellChange([checked_bit("value", raw)], None)
        if not self.is_part:
            return CellChange(kind.encode(raw), None)
        if self.part is not None:
            bits, mask = self.part.put("value", raw), self.part.mask
        else:
            bits, mask = self._named_bits(raw)
        return CellChange(kind.cells_of_number(bits), kind.cells_of_number(mask))

    def _raw_of(self, value: Any, scaling: Scaling | None) -> Any:
        if self._states is not None:
            return self._number_of(value, self._states)
        if scaling is None:
            return value
        low, high = self.limits
        if isinstance(low, float):
            return scaling.to_float(value)
        raw = scaling.to_whole(value)
        if not low <= raw <= high:
            least, most = sorted(map(scaling.to_value, (low, high)))
            raise WrongValue("value", f"must be in {least}..{most}, not {shown(value)}")
        return raw

    def _number_of(self, value: Any, states: States) -> Any:
        """Return the number of a state's name; other values as they are."""
        if not isinstance(value, str):
            return value
        number = states.number_of(value)
        is_flag = self._kind is None or (self.part is not None and self.part.is_flag)
        return bool(number) if is_flag else number

    def _named_bits(self, value: object) -> tuple[int, int]:
        """Return the bits of a mapping of names to values, and the mask of those bits."""
        bits = mask = 0
        for name, bit in instance("value", value, Mapping, "a dict of named bits").items():
            if name not in self.bits:
                names = ", ".join(self.bits)
                raise WrongValue("value", f"must have names of {names}, not {shown(name)}")
            bits |= self.bits[name].put(("value", name), bit)
            mask |= self.bits[name].mask
        return bits, mask
