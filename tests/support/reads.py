"""Reads of one register each, and a peer that answers a read with its address."""

from typing import Any

from libmodbus_py import pdu

from .peers import OnRequest, Write, answer, echo


def on_read(request: bytes, write: Write) -> None:
    """Answer a read over TCP at once."""
    write(echo(request))


def on_read_at(scheme: str, after: float = 0.0) -> OnRequest:
    """Return what answers a read over any transport, after so many seconds."""
    return lambda request, write: write(answer(request, scheme), after=after)


def reads(count: int, first: int = 0) -> list[pdu.Request[Any]]:
    return [pdu.ReadHoldingRegisters(address, 1) for address in range(first, first + count)]


def echoes(count: int, first: int = 0) -> list[list[int]]:
    """Return the values that a good peer answers to `reads`."""
    return [[address] for address in range(first, first + count)]
