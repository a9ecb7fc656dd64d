"""
Types of values: values as registers, and back, in each order of bytes; those of numbers and of
lists of bits, one row each in `NUMBERS`.

Data without a value, such as a digit above 9, is a ValueError when it is unpacked.
"""

from __future__ import annotations

import reprlib
import struct
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field
from typing import Any, SupportsFloat, SupportsIndex

from .checks import are_registers, integer, shown
from .mistakes import Path, WrongType, WrongValue, item
from .pdu.request import checked_bit
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
    if name in WIDE_ORDERS and 2 * kind.registers == len(name) and not kind.is_text:
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
            form = f"{self.registers} for {self.name}"
            raise WrongValue("registers", f"must hold {form}, not {len(cells)}")
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
            form = f"a multiple of {self.registers} for {self.name}"
            raise WrongValue("registers", f"must hold {form}, not {len(cells)}")
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
        """Return bytes in this order, or back: applied twice, each order changes nothing."""
        if self.order == "ABCD":
            return data
        if self.order in WIDE_ORDERS:
            return bytes(data[ord(letter) - ord("A")] for letter in self.order)
        words, swap = ORDERS[self.order]
        if words := words and not self.is_text:
            data = data[::-1]  # reversing swaps the bytes of each register, too
        if words == swap:
            return data
        result = bytearray(data)
        result[0::2], result[1::2] = data[1::2], data[0::2]
        return bytes(result)


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


# --- numbers and bits, in the order ABCD ------------------------------------------------------


def _whole(
    name: str,
    registers: int,
    limits: tuple[int, int],
    to_bytes: Callable[[int], bytes],
    from_bytes: Callable[[bytes], int],
) -> ValueType:
    def pack(path: str | Path, value: object) -> bytes:
        return to_bytes(integer(path, value, *limits))

    return ValueType(name, registers, pack, from_bytes, limits)


def _integers(bits: int, *, signed: bool) -> ValueType:
    """Two's complement or unsigned, in the last bytes; those in front are ignored when read."""
    registers = (bits + 15) // 16
    limits = (-1 << bits - 1, (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)

    def to_bytes(number: int) -> bytes:
        return number.to_bytes(2 * registers, "big", signed=signed)

    def from_bytes(data: bytes) -> int:
        return int.from_bytes(data[-bits // 8 :], "big", signed=signed)

    return _whole(f"{'' if signed else 'u'}int{bits}", registers, limits, to_bytes, from_bytes)


def _sign_and_magnitude(bits: int) -> ValueType:
    """The highest bit is the sign, the others are the amount; -0 is 0."""
    sign = 1 << bits - 1

    def to_bytes(number: int) -> bytes:
        return (abs(number) | sign * (number < 0)).to_bytes(bits // 8, "big")

    def from_bytes(data: bytes) -> int:
        number = int.from_bytes(data, "big")
        return sign - number if number & sign else number

    return _whole(f"signmag{bits}", bits // 16, (1 - sign, sign - 1), to_bytes, from_bytes)


def _modulo_10000(bits: int, *, signed: bool) -> ValueType:
    """Four digits in each register, more in the first; of negative numbers, all are negative."""
    registers = bits // 16
    form = f">{registers}{'h' if signed else 'H'}"
    modulus = 10_000
    high = (0x8000 if signed else 0x10000) * modulus ** (registers - 1) - 1

    def to_bytes(number: int) -> bytes:
        sign = -1 if number < 0 else 1
        rest, digits = abs(number), []
        for _ in range(registers - 1):
            rest, four = divmod(rest, modulus)
            digits.append(sign * four)
        return struct.pack(form, sign * rest, *reversed(digits))

    def from_bytes(data: bytes) -> int:
        number, *others = struct.unpack(form, data)
        for digits in others:
            if abs(digits) >= modulus:
                raise ValueError(f"{digits} has more than four digits")
            number = number * modulus + digits
        return int(number)

    name = f"{'' if signed else 'u'}mod10k{bits}"
    return _whole(name, registers, (-high if signed else 0, high), to_bytes, from_bytes)


def _decimals(bits: int, *, signed: bool = False) -> ValueType:
    """A decimal digit in each half byte; the first one is 0 or, for minus, F if there is a sign."""
    digits = bits // 4 - signed
    high = 10**digits - 1

    def to_bytes(number: int) -> bytes:
        sign = ("F" if number < 0 else "0") * signed
        return bytes.fromhex(f"{sign}{abs(number):0{digits}}")

    def from_bytes(data: bytes) -> int:
        text = data.hex().upper()
        sign, number = (text[0], text[1:]) if signed else ("0", text)
        if not number.isdecimal():
            raise ValueError(f"{text} has digits other than 0..9")
        if sign not in "08F":  # some set the highest bit only
            raise ValueError(f"{text} has no sign in front")
        return int(number) if sign == "0" else -int(number)

    limits = (-high if signed else 0, high)
    name = f"{'s' if signed else ''}bcd{bits}"
    return _whole(name, bits // 16, limits, to_bytes, from_bytes)


def _floats(bits: int, code: str, largest: float) -> ValueType:
    form = struct.Struct(f">{code}")

    def pack(name: str | Path, value: object) -> bytes:
        if isinstance(value, bool) or not isinstance(value, SupportsFloat | SupportsIndex):
            raise WrongType(name, f"must be a number, not {type(value).__name__}")
        try:
            return form.pack(float(value))
        except OverflowError:
            span = f"-{largest:.8g}..{largest:.8g}, infinite or nan"
            raise WrongValue(name, f"must be in {span}, not {shown(value)}") from None

    def unpack(data: bytes) -> float:
        value: float = form.unpack(data)[0]
        return value

    return ValueType(f"float{bits}", bits // 16, pack, unpack, (-largest, largest))


def _flags(bits: int) -> ValueType:
    def pack(name: str | Path, value: object) -> bytes:
        flags = items_of(name, value)
        if len(flags) != bits:
            raise WrongValue(name, f"must hold {bits} bits, lowest first, not {len(flags)}")
        number = sum(checked_bit(item(name, at), flag) << at for at, flag in enumerate(flags))
        return number.to_bytes(bits // 8, "big")

    def unpack(data: bytes) -> list[bool]:
        number = int.from_bytes(data, "big")
        return [bool(number >> at & 1) for at in range(bits)]

    return ValueType(f"bits{bits}", bits // 16, pack, unpack)


NUMBERS: tuple[ValueType, ...] = (
    *(_integers(bits, signed=True) for bits in (16, 32, 64, 8, 24, 48)),
    *(_integers(bits, signed=False) for bits in (16, 32, 64, 8, 24, 48)),
    _floats(16, "e", 65504.0),
    _floats(32, "f", (2 - 2**-23) * 2.0**127),
    _floats(64, "d", sys.float_info.max),
    *(_decimals(bits) for bits in (16, 32, 64)),
    *(_decimals(bits, signed=True) for bits in (16, 32)),
    *(_sign_and_magnitude(bits) for bits in (16, 32)),
    *(_modulo_10000(bits, signed=True) for bits in (32, 48, 64)),
    *(_modulo_10000(bits, signed=False) for bits in (32, 48, 64)),
    *(_flags(bits) for bits in (16, 32, 64)),
)
"""The types, the usual ones of each kind first."""
