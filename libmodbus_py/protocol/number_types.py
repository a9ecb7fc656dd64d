"""
Types of numbers and of lists of bits: their registers in the order ABCD, one row each in `NUMBERS`.

Data without a value, such as a digit above 9, is a ValueError when it is unpacked.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from typing import Any, SupportsFloat, SupportsIndex

from .checks import integer, shown
from .mistakes import Path, WrongType, WrongValue, item
from .value_types import ValueType, items_of

MODULUS = 10_000
"""Registers of some meters hold four decimal digits each."""


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
    first = 0x7FFF if signed else 0xFFFF
    high = (first + 1) * MODULUS ** (registers - 1) - 1

    def to_bytes(number: int) -> bytes:
        rest, sign, digits = abs(number), -1 if number < 0 else 1, []
        for _ in range(registers - 1):
            rest, four = divmod(rest, MODULUS)
            digits.append(sign * four)
        return struct.pack(form, sign * rest, *reversed(digits))

    def from_bytes(data: bytes) -> int:
        first, *others = struct.unpack(form, data)
        number = int(first)
        for digits in others:
            if abs(digits) >= MODULUS:
                raise ValueError(f"{digits} has more than four digits")
            number = number * MODULUS + digits
        return number

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
        number = sum(_bit(item(name, at), flag) << at for at, flag in enumerate(flags))
        return number.to_bytes(bits // 8, "big")

    def unpack(data: bytes) -> list[bool]:
        number = int.from_bytes(data, "big")
        return [bool(number >> at & 1) for at in range(bits)]

    return ValueType(f"bits{bits}", bits // 16, pack, unpack)


def _bit(name: str | Path, flag: Any) -> int:
    return int(flag) if isinstance(flag, bool) else integer(name, flag, 0, 1)


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
