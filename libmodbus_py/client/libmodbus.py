"""
Carries a plain request in one call of C, without the GIL; on serial lines libmodbus sends.
"""

from __future__ import annotations

import os

from ..binding.library import ffi, lib
from ..ports.port import Port, lost
from ..ports.waiting import LONGEST
from ..protocol.errors import ModbusConnectionError
from ..protocol.framing import pdu_with_crc

__all__ = ["NativeCarrier"]


class NativeCarrier:
    """
    See `shortcut.Carrier`.

    Args:
        port: a TCP connection, a UDP socket, or a serial port in RTU mode.
    """

    def __init__(self, port: Port) -> None:
        self._port = port
        self._exchange = ffi.new("exchange_t *")
        self._answer = ffi.buffer(self._exchange.answer)
        if port.context is not None:
            self._exchange.context = port.context

    def carry(self, unit: int, number: int, pdu: bytes, timeout: float, waker: int) -> bytes | None:
        wait = min(timeout, LONGEST)  # the conversation waits for the rest
        size = lib.exchange(
            self._exchange, self._port.descriptor, waker, unit, number, pdu, len(pdu), wait
        )
        if size > 0:
            answer: bytes = self._answer[7 : 7 + size]
            return answer
        if size < 0:
            return None
        got: bytes = self._answer[: self._exchange.got]
        return pdu_with_crc(got, unit) if self._exchange.context else b""

    @property
    def received(self) -> list[bytes]:
        got: bytes = self._answer[: self._exchange.got]
        return [got] if got else []

    @property
    def error(self) -> ModbusConnectionError | None:
        number = self._exchange.error
        return lost(OSError(number, os.strerror(number))) if number else None
