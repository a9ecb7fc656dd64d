"""
The base of all requests, and of those that are echoed; the fields of messages: checked arguments,
and their bytes.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Iterable, Mapping, Sequence, Set
from itertools import islice
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar
from weakref import WeakSet

from ..checks import are_registers, instance, integer, log_failure
from ..errors import ExceptionResponse, InvalidResponse, in_hex
from ..mistakes import Path, WrongType, WrongValue, explain_reference
from ..scan import MAX_PDU as MAX_PDU
from ..scan import lib

Result = TypeVar("Result")

NO_LENGTH = MAX_PDU + 1
"""More bytes than a PDU has."""

TABLE_SIZE = 65536  # section 4.4: addresses are 16 bits

MAX_WRITTEN = {"coils": 1968, "holding_registers": 123}
"""Table -> the most cells of one write (6.11, 6.12); here, because readers do not import writes."""


class LengthRule(Protocol):
    """
    Given the first bytes of a PDU: its whole length.

    None until that is known; 0 if nothing in it tells.
    """

    def __call__(self, head: bytes) -> int | None: ...


# --- arguments ---------------------------------------------------------------------


class AddressError(WrongValue):
    """An address that no table has: a server answers 2 to it, not 3."""


def checked_bit(name: str | Path, value: object) -> bool:
    return value if isinstance(value, bool) else bool(integer(name, value, 0, 1))


def checked_register(name: str, value: object) -> int:
    return integer(name, value, 0, 0xFFFF)


def checked_sequence(name: str, values: object, limit: int) -> tuple[Any, ...]:
    # Text, sets and mappings are iterable, but never a run of registers.
    unfit = isinstance(values, str | bytes | bytearray | Set | Mapping)
    if unfit or not isinstance(values, Iterable):
        text = type(values).__name__
        raise WrongType(name, f"must be a sequence of 1..{limit} values, not {text}")
    items = tuple(islice(values, limit + 1))
    if not 1 <= len(items) <= limit:
        text = f"{len(items)}" if len(items) <= limit else f"more than {limit}"
        raise WrongValue(name, f"must hold 1..{limit} values, not {text}")
    return items


def checked_bits(name: str, values: object, limit: int) -> tuple[bool, ...]:
    bits = checked_sequence(name, values, limit)
    if set(map(type, bits)) == {bool}:
        return bits
    return tuple(checked_bit(f"{name}[{at}]", value) for at, value in enumerate(bits))


def checked_registers(name: str, values: object, limit: int) -> tuple[int, ...]:
    registers = checked_sequence(name, values, limit)
    if are_registers(registers):
        return registers
    return tuple(checked_register(f"{name}[{at}]", value) for at, value in enumerate(registers))


def checked_data(name: str, value: object, limit: int) -> bytes:
    data: bytes = instance(name, value, bytes, "bytes")
    if len(data) > limit:
        raise WrongValue(name, f"must be up to {limit} bytes, not {len(data)}")
    return data


def checked_span(name: str, address: object, count_name: str, count: int) -> int:
    try:
        start = integer(name, address, 0, TABLE_SIZE - 1)
    except WrongValue as error:
        hint = explain_reference(address)
        raise WrongValue(name, f"{error.reason}; {hint}" if hint else error.reason) from None
    if start + count > TABLE_SIZE:
        reason = f"must not pass {TABLE_SIZE}, but {start} + {count} does"
        raise AddressError(name, f"+ {count_name} {reason}")
    return start


def store(request: object, **values: object) -> None:
    for name, value in values.items():
        object.__setattr__(request, name, value)


# --- bytes -------------------------------------------------------------------------


def pack_bits(bits: Sequence[bool]) -> bytes:
    value = 0
    for position, bit in enumerate(bits):
        if bit:
            value |= 1 << position
    return value.to_bytes((len(bits) + 7) // 8, "little")


def unpack_bits(data: bytes, count: int) -> list[bool]:
    return [bool(data[position >> 3] >> (position & 7) & 1) for position in range(count)]


REGISTERS: list[struct.Struct] = [struct.Struct(f">{count}H") for count in range(MAX_PDU // 2 + 1)]
"""By the number of registers; made once, because bulk reads do little else."""


def pack_registers(values: Sequence[int]) -> bytes:
    return REGISTERS[len(values)].pack(*values)


def unpack_registers(data: bytes) -> tuple[int, ...]:
    return REGISTERS[len(data) // 2].unpack(data)


def exactly(count: int, values: tuple[Any, ...]) -> tuple[Any, ...]:
    if len(values) != count:
        raise WrongValue("result", f"must hold {count} values, not {len(values)}")
    return values


def encode_registers(function: int, result: Sequence[int], count: int) -> bytes:
    data = pack_registers(exactly(count, checked_registers("result", result, count)))
    return bytes([function, len(data)]) + data


# Rule -> the same for scan.c: how, `base` and `at`. It asks Python for all others.
IN_C: dict[LengthRule, tuple[int, int, int]] = {}


def in_c(rule: LengthRule, byte_count_at: int, base: int = 0, at: int = 0) -> LengthRule:
    """Note that the C scanner has this rule, too."""
    if 0 <= base <= MAX_PDU and 0 <= at < MAX_PDU:
        IN_C[rule] = byte_count_at, base, at
    return rule


def fixed(length: int) -> LengthRule:
    """A rule: always `length` bytes."""
    return in_c(lambda head: length, lib.FIXED, length)


def counted(base: int, at: int) -> LengthRule:
    """A rule: the byte at `at` counts those that follow the first `base`."""
    return in_c(lambda head: base + head[at] if len(head) > at else None, lib.COUNTED, base, at)


def unknown_length(head: bytes) -> int:
    """A rule: nothing in the PDU determines its length."""
    return 0


in_c(unknown_length, lib.BY_CRC)


# --- requests ----------------------------------------------------------------------


class Request(Generic[Result]):
    """
    The base of all requests.

    Class attributes:
        function: the function code, 1..127.
        request_length, response_length: length rules of the two PDUs.
        may_be_broadcast: True if unit 0 may stand for all units, because the request changes the
            device and its response contains nothing new.
        repeatable: True if it may be sent again when its response was lost, because executing it
            twice has the same effect as executing it once.
        changes: False if it changes nothing in the device, so that it may be sent beside others.

    Attributes:
        expects_response: True if a server answers it, unless it is a broadcast.

    Constructors raise TypeError or ValueError with the name of the argument and its
    range; ``str()`` of a request describes it in words, for messages.
    """

    __slots__ = ()

    function: ClassVar[int]
    request_length: ClassVar[LengthRule]
    response_length: ClassVar[LengthRule]
    may_be_broadcast: ClassVar[bool] = False
    repeatable: ClassVar[bool] = False
    changes: bool = True
    expects_response: bool = True

    def encode(self) -> bytes:
        """Encode the request PDU."""
        raise NotImplementedError

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        """
        Decode a request PDU of this function, whose length has been checked.

        Raises:
            ValueError: a quantity, byte count or constant is wrong.
        """
        raise NotImplementedError

    def encode_response(self, result: Result) -> bytes:
        """
        Encode the response PDU that a server sends.

        Args:
            result: the result that the client's method for this function returns.

        Raises:
            TypeError, ValueError: the result does not fit the request.
        """
        raise NotImplementedError

    def decode_response(self, pdu: bytes) -> Result:
        """
        Decode the response PDU.

        Returns:
            The result that the client's method for this function returns.

        Raises:
            ExceptionResponse: the server refused the request; the subclass for the code.
            InvalidResponse: the PDU is not a valid response to this request.
        """
        if not pdu or pdu[0] != self.function:
            raise self._refusal(pdu)
        length = type(self).response_length(pdu)
        if length != len(pdu) and length != 0:
            return self._decode_misfit(pdu, length)
        return self._decode_response(pdu)

    def _decode_misfit(self, pdu: bytes, length: int | None) -> Result:
        raise self._invalid(f"a response of {len(pdu)} bytes: {in_hex(pdu)}")

    def _decode_response(self, pdu: bytes) -> Result:
        raise NotImplementedError

    def _refusal(self, pdu: bytes) -> ExceptionResponse | InvalidResponse:
        if len(pdu) == 2 and pdu[0] == self.function | 0x80:
            return ExceptionResponse.of(pdu[1], function=self.function, asked=str(self))
        error = self._invalid(f"response {pdu[:8].hex(' ') or 'without a byte'}")
        error.answers_another = bool(pdu) and pdu[0] & 0x7F != self.function
        return error

    def _invalid(self, what: str) -> InvalidResponse:
        return InvalidResponse(f"answered with {what}", function=self.function, asked=str(self))

    def __str__(self) -> str:
        texts = (f"{name}={reprlib.repr(value)}" for name, value in arguments(self).items())
        return f"{type(self).__name__}({', '.join(texts)})"


# Classes of which a mistake in a length rule has been logged.
_mistaken: WeakSet[type[Request[Any]]] = WeakSet()


def length_by(request: type[Request[Any]], rule: LengthRule, head: bytes) -> int | None:
    """Return the result of a rule; `NO_LENGTH` if a registered rule raises or is wrong."""
    if rule in IN_C:
        return rule(head)
    # A mistake in one rule must not stop all other functions of a line.
    try:
        length = rule(head)
        if length is None or (isinstance(length, int) and length >= 0):
            return length
        raise ValueError(f"a length rule returned {length!r}, not None or a number of bytes")
    except Exception:
        if request not in _mistaken:
            _mistaken.add(request)
            text = "%s: frames of function %d are dropped because of its length rule"
            log_failure(__name__, text, request.__name__, request.function)
    return NO_LENGTH


def arguments(request: Request[Any]) -> dict[str, Any]:
    """Return the arguments of a request by name: the fields of a dataclass, or its attributes."""
    from dataclasses import fields, is_dataclass

    if not is_dataclass(request):
        attributes = getattr(request, "__dict__", {})
        return {name: value for name, value in attributes.items() if name[0] != "_"}
    names = [field.name for field in fields(request) if field.repr]
    return {name: getattr(request, name) for name in names if hasattr(request, name)}


class WordRequest(Request[Result]):
    """A request whose fields, those of a dataclass, are 16 bits each."""

    __slots__ = ()

    __match_args__: ClassVar[tuple[str, ...]] = ()

    def encode(self) -> bytes:
        fields = [getattr(self, name) for name in self.__match_args__]
        return bytes([self.function]) + pack_registers(fields)

    @classmethod
    def decode(cls, pdu: bytes) -> Self:
        return cls(*unpack_registers(pdu[1:]))


class EchoedWrite(Request[None]):
    """
    A write whose response repeats the first bytes of the request.

    Bytes behind the echo, which some devices send, are ignored: the write was carried out.
    """

    __slots__ = ()
    may_be_broadcast = True
    repeatable = True
    echoed: ClassVar[int]

    def encode_response(self, result: None = None) -> bytes:
        return self.encode()[: self.echoed]

    def _decode_misfit(self, pdu: bytes, length: int | None) -> None:
        if not pdu.startswith(self.encode_response()):
            super()._decode_misfit(pdu, length)

    def _decode_response(self, pdu: bytes) -> None:
        if pdu != self.encode_response():
            raise self._invalid(f"the echo {in_hex(pdu)}")
