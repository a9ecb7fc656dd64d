"""
The meaning of raw values beyond scale and offset: no value, states, named bits, parts of
registers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from ..protocol.checks import shown
from ..protocol.mistakes import WrongValue
from ..protocol.values import ValueType
from .parts import Part, put_named

__all__ = ["Judged", "Meaning", "NoValue", "Reason", "sunspec_missing"]

Reason = Literal["Missing", "Implausible", "InvalidTime", "BadScale"]

Scale = Callable[[Any], Any]
"""Function that converts a raw number to a scaled one."""


class NoValue(ValueError):
    """
    The registers of a point hold no value; the message says why.

    Args:
        name: the name of the point.
        reason: "Missing" if the device reports that there is no value, "Implausible" if the value
            is below `plausible_minimum` or above `plausible_maximum`, "InvalidTime" if the
            registers hold no valid time, "BadScale" if the point named by `scale_from` holds no
            scale.
        text: the reason as a sentence about the point.

    Attributes:
        name, reason: as given.
    """

    def __init__(self, name: str, reason: Reason, text: str) -> None:
        super().__init__(name, reason, text)
        self.name: str = name
        self.reason: Reason = reason

    def __str__(self) -> str:
        return f"{self.name} {self.args[2]}"


class Judged(NamedTuple):
    """
    A value of a point, or the reason why there is none.

    Attributes:
        value: as `Point.decode` returns it; None if there is none.
        quality: "good", or "bad" if there is no value.
        reason: that of `NoValue`, and empty with a value; of a list, the reason of the first
            item that is None.
    """

    value: Any
    quality: Literal["good", "bad"] = "good"
    reason: Reason | Literal[""] = ""

    @classmethod
    def of(cls, found: Sequence[Any], *, is_list: bool) -> Judged:
        """Return the values that were found in a point, where `NoValue` stands for none."""
        bad = [each for each in found if isinstance(each, NoValue)]
        if not is_list:
            return cls(None, "bad", bad[0].reason) if bad else cls(found[0])
        values = [None if isinstance(each, NoValue) else each for each in found]
        quality: Literal["good", "bad"] = "bad" if len(bad) == len(found) else "good"
        return cls(values, quality, bad[0].reason if bad else "")


class Meaning:
    """
    Turns raw values of a point into values or `NoValue`, and back into bits.

    Args:
        name: of the point.
        kind: of its registers; None for a table of bits.
        missing: raw values that mean no value.
        span: the lowest and the highest plausible value.
        part: the bits of the registers that are the raw value; None for all of them.
        states: raw number -> name; empty for numbers.
        bits: name -> bits; empty unless the value is a dict.

    Attributes:
        judge: returns the value of a raw value, or a `NoValue`; its second argument converts
            raw numbers to scaled ones, or is None.
        from_bytes: returns the raw value of some bytes; raises ValueError if they hold none.
        parts: the bits that are written, if not all: a mask write changes them.
    """

    __slots__ = (
        "_bits",
        "_kind",
        "_missing",
        "_name",
        "_numbers",
        "_span",
        "_states",
        "from_bytes",
        "judge",
        "part",
    )

    def __init__(
        self,
        name: str,
        kind: ValueType | None,
        *,
        missing: frozenset[Any],
        span: tuple[float, float] | None,
        part: Part | None,
        states: Mapping[int, str],
        bits: Mapping[str, Part],
    ) -> None:
        self._name, self._kind = name, kind
        self._missing, self._span = missing, span
        self._states, self._bits = states, bits
        self._numbers = {text: number for number, text in states.items()}
        self.part: Part | None = part
        self.from_bytes: Callable[[bytes], Any] = self._reader(kind)
        self.judge: Callable[[Any, Scale | None], Any] = self._judge()

    @property
    def mask(self) -> int:
        """The bits of the registers that writing changes, if not all."""
        parts = self._bits.values() if self.part is None else [self.part]
        return sum(part.mask for part in parts)

    @property
    def is_part(self) -> bool:
        """True if writing changes some bits of the registers only."""
        return self.part is not None or bool(self._bits)

    # --- read ------------------------------------------------------------------------------

    def _reader(self, kind: ValueType | None) -> Callable[[bytes], Any]:
        if kind is None:
            return bool
        if self.part is not None:
            to_number, of = kind.to_number, self.part.of
            return lambda data: of(to_number(data))
        return kind.to_number if self._bits else kind.reader

    def _judge(self) -> Callable[[Any, Scale | None], Any]:
        if self._bits:
            return self._named_bits
        if self._states:
            return self._state
        if self.part is not None or (self._kind is not None and self._kind.limits is not None):
            return self._number_judge()
        is_list = self._kind is not None and self._kind.name.startswith("bits")
        return self._list if is_list else self._other

    def _named_bits(self, raw: int, scale: Scale | None) -> Any:
        if raw in self._missing:
            return self._missed(raw)
        return {name: part.of(raw) for name, part in self._bits.items()}

    def _state(self, raw: int, scale: Scale | None) -> Any:
        return self._missed(raw) if raw in self._missing else self._states.get(raw, raw)

    def _list(self, raw: list[bool], scale: Scale | None) -> Any:
        number = sum(bit << at for at, bit in enumerate(raw))
        return self._missed(number) if number in self._missing else raw

    def _other(self, raw: Any, scale: Scale | None) -> Any:
        """Return a text or a time."""
        return self._missed(raw) if raw in self._missing else raw

    def _number_judge(self) -> Callable[[Any, Scale | None], Any]:
        # A closure, because most points are numbers, and attributes take as long as the rest.
        missing, (low, high) = self._missing, self._span or (-math.inf, math.inf)

        def judge(raw: Any, scale: Scale | None) -> Any:
            if raw in missing:
                return self._missed(raw)
            value = raw if scale is None else scale(raw)
            return value if low <= value <= high else self._doubted(value)

        return judge

    def _doubted(self, value: float) -> NoValue:
        if value != value:  # only nan differs from itself
            return self._missed(value)
        span = self._span or ()
        wanted = "..".join("" if math.isinf(each) else str(each) for each in span)
        return NoValue(self._name, "Implausible", f"is {shown(value)}, and plausible is {wanted}")

    def _missed(self, raw: object) -> NoValue:
        return NoValue(self._name, "Missing", f"has no value: the device says {shown(raw)}")

    # --- write -----------------------------------------------------------------------------

    def bits_of(self, value: object) -> tuple[int, int]:
        """
        Return the bits of a value of named bits or of a part, and the mask of those bits.

        Args:
            value: a raw number for a part.

        Raises:
            TypeError, ValueError: it cannot hold the value.
        """
        if self._bits:
            return put_named(self._bits, value)
        assert self.part is not None
        return self.part.put("value", value), self.part.mask

    def number_of(self, value: Any) -> Any:
        """
        Return the number of a state's name; other values as they are.

        Raises:
            ValueError: there is no state of this name.
        """
        if not self._states or not isinstance(value, str):
            return value
        if value not in self._numbers:
            allowed = ", ".join(self._numbers)
            raise WrongValue("value", f"must be one of {allowed}, or a number, not {value!r}")
        number = self._numbers[value]
        is_flag = self._kind is None or (self.part is not None and self.part.is_flag)
        return bool(number) if is_flag else number


# --- raw values that mean none ----------------------------------------------------------

_SUNSPEC = {
    "int16": 0x8000,
    "uint16": 0xFFFF,
    "int32": 0x8000_0000,
    "uint32": 0xFFFF_FFFF,
    "int64": 0x8000_0000_0000_0000,
    "uint64": 0xFFFF_FFFF_FFFF_FFFF,
    "bits16": 0xFFFF,
    "bits32": 0xFFFF_FFFF,
    "bits64": 0xFFFF_FFFF_FFFF_FFFF,
}


def sunspec_missing(kind: ValueType) -> int | None:
    """
    Return the bits of "not implemented" in a type of SunSpec; None for a float, whose nan means
    no value anyway.

    Raises:
        ValueError: SunSpec has no such type.
    """
    if kind.is_text:
        return 0
    if kind.name in ("float32", "float64"):
        return None
    if kind.name not in _SUNSPEC:
        raise WrongValue("missing", f"must be numbers for {kind.name}, which SunSpec does not have")
    return _SUNSPEC[kind.name]
