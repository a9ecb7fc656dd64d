"""
Types of values: values as registers, and back, in each order of bytes.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any

from .checks import are_registers, integer
from .mistakes import Path, WrongType, WrongValue
from .words import ORDER_WORDS, close_word, order_named

ORDERS: dict[str, tuple[bool, bool]] = {
    "ABCD": (False, False),
    "CDAB": (True, False),
    "BADC": (False, True),
    "DCBA": (True, True),
}
"""Order -> (registers reversed, bytes of each swapped)."""

WIDE_ORDERS = ("EFGHABCD", "CDABGHEF", "FEHGBADC", "DCBAHGFE")
"""Orders of 64 bits only. Like those above, each undoes itself."""

WIDE_REGISTERS = 4
"""The registers of 64 bits."""

# The same orders written out: name and registers.
_SPELLINGS = {
    "AB": ("ABCD", 1),
    "BA": ("BADC", 1),
    "ABCDEF": ("ABCD", 3),
    "EFCDAB": ("CDAB", 3),
    "BADCFE": ("BADC", 3),
    "FEDCBA": ("DCBA", 3),
    "ABCDEFGH": ("ABCD", 4),
    "GHEFCDAB": ("CDAB", 4),
    "BADCFEHG": ("BADC", 4),
    "HGFEDCBA": ("DCBA", 4),
}


def checked_order(order: object, kind: ValueType) -> str:
    """Return the four letters of an order; a spelling of another width is a mistake."""
    if not isinstance(order, str):
        raise WrongType("order", f"must be one of {', '.join(ORDERS)}, not {type(order).__name__}")
    name, width = _SPELLINGS.get(order.upper(), (order.upper(), None))
    if name in WIDE_ORDERS and kind.registers == WIDE_REGISTERS and not kind.is_text:
        return name
    name = name if name in ORDERS else order_named(order) or name
    if name not in ORDERS and name not in WIDE_ORDERS:
        close = close_word(name, ORDERS, ORDER_WORDS)
        form = f"must be one of {', '.join(ORDERS)}"
        raise WrongValue("order", f"{form}, not {reprlib.repr(order)}{close}")
    if name in WIDE_ORDERS or width not in (None, 1 if kind.is_text else kind.registers):
        form = f"one of {', '.join(ORDERS)}"
        raise WrongValue("order", f"of {kind.name} must be {form}, not {order!r}")
    return name


# --- types -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ValueType:
    """
    A type of values in one byte order, made by `value_type`.

    Attributes:
        name: the name of the type, as in the module's docstring.
        registers: the number of registers of one value, 1..125.
        pack: returns the bytes of a value in the order ABCD; takes its name for errors, and it.
        unpack: returns the value of bytes in the order ABCD; raises ValueError.
        order: ABCD, CDAB, BADC or DCBA, or one of `WIDE_ORDERS`.
        limits: the lowest and the highest number; None if values are not numbers.
        is_text: True if the registers are in reading order, whatever the order.
        is_time: True if values are datetimes, with a time zone.
    """

    name: str
    registers: int
    pack: Callable[[str | Path, Any], bytes] = field(repr=False)
    unpack: Callable[[bytes], Any] = field(repr=False)
    limits: tuple[int, int] | tuple[float, float] | None = None
    is_text: bool = False
    order: str = "ABCD"
    is_time: bool = False

    def encode(self, value: Any) -> list[int]:
        """
        Return the registers of one value, 0..65535 each.

        Args:
            value: a number; for bits, a list of True and False, lowest first; for string:N and
                eui48, a string, which is never truncated; for times, a datetime with a time zone,
                whose fractions of a second are dropped if the type has none.

        Raises:
            TypeError, ValueError: the value does not fit the type.
        """
        return self._to_registers("value", value)

    def encode_many(self, values: Iterable[Any]) -> list[int]:
        """
        Return the registers of values, one value after the other.

        Raises:
            TypeError, ValueError: `values` is not a list, or a value does not fit the type; the
                message names the value.
        """
        registers = []
        for at, value in enumerate(items_of("values", values)):
            registers += self._to_registers(("values", at), value)
        return registers

    def decode(self, registers: Iterable[int]) -> Any:
        """
        Return the value of its registers.

        Returns:
            An int, a float, a list of True and False, a datetime in UTC, or a string without the
            padding at its end.

        Raises:
            TypeError, ValueError: there are too many or too few registers, they are not
                0..65535 each, or they hold no such value.
        """
        cells = cells_of(registers)
        if len(cells) != self.registers:
            raise WrongValue(
                "registers", f"must hold {self.registers} for {self.name}, not {len(cells)}"
            )
        return self._from_registers(cells)[0]

    def decode_many(self, registers: Iterable[int]) -> list[Any]:
        """
        Return the values of registers, one after the other; an empty list without registers.

        Raises:
            TypeError, ValueError: the last value is incomplete, or registers are not 0..65535
                each or hold no such value; the message names the registers.
        """
        cells = cells_of(registers)
        if len(cells) % self.registers:
            raise WrongValue(
                "registers",
                f"must hold a multiple of {self.registers} for {self.name}, not {len(cells)}",
            )
        return self._from_registers(cells)

    def _to_registers(self, name: str | Path, value: object) -> list[int]:
        data = self._reordered(self.pack(name, value))
        return list(struct.unpack(f">{self.registers}H", data))

    def _from_registers(self, cells: list[int]) -> list[Any]:
        values = self.values_in(cells)
        for number, value in enumerate(values):
            if isinstance(value, ValueError):
                at, end = number * self.registers, (number + 1) * self.registers
                raise ValueError(f"registers[{at}:{end}] hold no {self.name}: {value}")
        return values

    def values_in(self, cells: Sequence[int]) -> list[Any]:
        """Return the values of registers; a ValueError stands for data that is no value."""
        data = struct.pack(f">{len(cells)}H", *cells)
        values: list[Any] = []
        for at in range(0, len(data), 2 * self.registers):
            try:
                values.append(self.from_bytes(data[at : at + 2 * self.registers]))
            except ValueError as error:
                values.append(error)
        return values

    def from_bytes(self, data: bytes) -> Any:
        """Return the value of the bytes of its registers; raise a ValueError if there is none."""
        return self.unpack(self._reordered(data))

    @property
    def reader(self) -> Callable[[bytes], Any]:
        """Return a function that does the same as `from_bytes`, with fewer calls if possible."""
        return self.unpack if self.order == "ABCD" else self.from_bytes

    def to_number(self, data: bytes) -> int:
        """Return the bits of one value as an unsigned number."""
        return int.from_bytes(self._reordered(data), "big")

    def cells_of_number(self, number: int) -> list[int]:
        """Return the registers that contain the bits of an unsigned number."""
        data = self._reordered(number.to_bytes(2 * self.registers, "big"))
        return list(struct.unpack(f">{self.registers}H", data))

    def _reordered(self, data: bytes) -> bytes:
        """Return bytes in this order, or back: each order undoes itself."""
        if self.order == "ABCD":
            return data
        if self.order in WIDE_ORDERS:
            return bytes(data[ord(letter) - ord("A")] for letter in self.order)
        words, swap = ORDERS[self.order]
        if words := words and not self.is_text:
            data = data[::-1]  # which swaps the bytes of each, too
        if words == swap:
            return data
        swapped = bytearray(data)
        swapped[0::2], swapped[1::2] = data[1::2], data[0::2]
        return bytes(swapped)


def items_of(name: str | Path, values: object) -> list[Any]:
    # Text, sets and mappings are iterable, but never a run of values.
    unfit = isinstance(values, str | bytes | bytearray | Set | Mapping)
    if unfit or not isinstance(values, Iterable):
        raise WrongType(name, f"must be a list, not {type(values).__name__}")
    return list(values)


def cells_of(registers: object) -> list[int]:
    values = registers if type(registers) is list else items_of("registers", registers)
    if are_registers(values):
        return values
    return [integer(("registers", at), cell, 0, 0xFFFF) for at, cell in enumerate(values)]
