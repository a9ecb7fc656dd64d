"""
The walk along a chain of SunSpec models: yields requests, is sent answers.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from ...client.requests import Several, Steps
from ...protocol import pdu
from ...protocol.checks import integer
from ...protocol.errors import ExceptionResponse, ModbusError
from ...protocol.mistakes import WrongType, WrongValue
from ...protocol.tables import TABLE_SIZE

# fmt: off
__all__ = [
    "BASES", "END", "HEADER", "MARKER", "Chain", "Header", "SunSpecError", "checked_bases",
    "read_span", "walk",
]
# fmt: on

BASES = (0, 40000, 50000)
"""The addresses at which SunSpec allows a chain to begin."""

MARKER = [0x5375, 0x6E53]
"""The registers of "SunS", with which a chain begins."""

END = 0xFFFF
"""The id of the end model."""

HEADER = 2
"""Registers of the header of a model: id and length."""

# The longest chains of real devices have some thirty models.
MOST_MODELS = 256

# Addresses at which a chain is sought; SunSpec names three.
MOST_BASES = 16

# Registers of one response (function 3).
MOST_REGISTERS = 125


class SunSpecError(ModbusError):
    """The device has no chain of SunSpec models at the given addresses."""


class Header(NamedTuple):
    """
    The header of one model.

    Attributes:
        id: 1..65534.
        address: of the register with the id.
        length: the number of registers after the header.
    """

    id: int
    address: int
    length: int


@dataclass
class Chain:
    """
    The headers of a chain of models.

    Attributes:
        base: the address of the marker.
        headers: in their order, without the end model.
        end: the address of the end model; None if the chain ends without one.
        notes: what is wrong with the chain, each as one sentence.
    """

    base: int
    headers: list[Header] = field(default_factory=list)
    end: int | None = None
    notes: list[str] = field(default_factory=list)


def checked_bases(bases: Iterable[int]) -> tuple[int, ...]:
    """
    Return the addresses at which a chain may begin.

    Raises:
        TypeError, ValueError: `bases` is not a list of 1..16 addresses.
    """
    if isinstance(bases, str | bytes) or not isinstance(bases, Iterable):
        raise WrongType("bases", f"must be a list of addresses, not {type(bases).__name__}")
    most = TABLE_SIZE - len(MARKER)
    found = tuple(integer(("bases", at), each, 0, most) for at, each in enumerate(bases))
    if not 1 <= len(found) <= MOST_BASES:
        raise WrongValue("bases", f"must hold 1..{MOST_BASES} addresses, not {len(found)}")
    return tuple(dict.fromkeys(found))


def walk(bases: Iterable[int]) -> Steps[Chain]:
    """
    Find the marker, and follow the chain to its end.

    Raises:
        SunSpecError: there is no marker.
        ModbusError: there is no answer.
    """
    chain = yield from _begun(bases)
    address = chain.base + len(MARKER)
    while len(chain.headers) < MOST_MODELS:
        if address + HEADER > TABLE_SIZE:
            chain.notes.append("the chain has no end model before address 65535")
            return chain
        answer = yield from _asked(address, HEADER)
        if isinstance(answer, ExceptionResponse):
            chain.notes.append(f"the chain has no end model: address {address}: {answer}")
            return chain
        header = Header(answer[0], address, answer[1])
        if header.id == END:
            chain.end = address
            return chain
        if note := _mistake(header):
            chain.notes.append(note)
            return chain
        chain.headers.append(header)
        address += HEADER + header.length
    chain.notes.append(f"the chain has more than {MOST_MODELS} models; the rest is left out")
    return chain


def _begun(bases: Iterable[int]) -> Steps[Chain]:
    reasons = []
    for base in bases:
        answer = yield from _asked(base, len(MARKER))
        if answer == MARKER:
            return Chain(base)
        told = answer if isinstance(answer, ExceptionResponse) else "no SunS there"
        reasons.append(f"address {base}: {told}")
    raise SunSpecError(f"the device has no SunSpec models: {'; '.join(reasons)}")


def _mistake(header: Header) -> str:
    if header.id == 0:
        return f"the chain has no end model: there is no model 0, as at address {header.address}"
    if header.address + HEADER + header.length > TABLE_SIZE:
        return (
            f"model {header.id} at address {header.address} is left out: its length,"
            f" {header.length}, leads beyond address 65535"
        )
    return ""


def read_span(address: int, count: int) -> Steps[list[int] | ExceptionResponse]:
    """
    Read registers in as few requests as there can be.

    Returns:
        The registers, or the exception response to one of the requests.
    """
    found: list[int] = []
    for first, length in _pieces(address, count):
        answer = yield from _asked(first, length)
        if isinstance(answer, ExceptionResponse):
            return answer
        found += answer
    return found


def _pieces(address: int, count: int) -> Iterator[tuple[int, int]]:
    stop = address + count
    for first in range(address, stop, MOST_REGISTERS):
        yield first, min(MOST_REGISTERS, stop - first)


def _asked(address: int, count: int) -> Generator[Any, Any, list[int] | ExceptionResponse]:
    """Ask for registers; return them, or the exception response."""
    (answer,) = yield Several([pdu.ReadHoldingRegisters(address, count)], 1, True)
    if isinstance(answer, ModbusError) and not isinstance(answer, ExceptionResponse):
        raise answer
    return answer  # type: ignore[no-any-return]
