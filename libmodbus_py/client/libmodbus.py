"""
The short way for a single request whose answer can only be its own, through C or without.

A way around the conversation while that has nothing to say: nothing in flight, nothing
half received, no late answer that may still come. What is not plainly the answer is handed
over to the conversation, bytes and all, which goes on waiting and says what it was.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from time import monotonic
from typing import Any

from ..binding.library import ffi, lib
from ..ports.port import lost
from ..ports.serial import SerialPort
from ..ports.waiting import Woken
from ..protocol.errors import ModbusConnectionError, ModbusError
from ..protocol.framing import Frame, crc16, make_framer, mbap
from ..protocol.pdu import Request
from .batch import Batch, Patience, encoded
from .options import Parts

__all__ = ["KNOWN", "Shortcut"]

IsReady = Callable[[float], bool]

KNOWN = frozenset((1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The function codes that libmodbus has."""


class Shortcut:
    """
    Carries single requests where frames show by themselves that they are whole.

    Args:
        parts: of the client.
        native: whether one call of C looks, sends, waits and reads, without the GIL; on
            serial lines libmodbus sends.
    """

    def __init__(self, parts: Parts, native: bool) -> None:
        self._port = parts.port
        self._conversation = parts.conversation
        self._connection = parts.connection
        self._statistics = parts.statistics
        self._has_header = parts.endpoint.framing in ("tcp", "udp")
        self._encode = make_framer(parts.endpoint.framing, "client").encode
        self._exchange = ffi.new("exchange_t *")
        self._answer = ffi.buffer(self._exchange.answer)
        self._data = b""  # that came and must be looked at
        self._error: ModbusConnectionError | None = None
        is_line = isinstance(parts.port, SerialPort)
        if isinstance(parts.port, SerialPort):
            self._exchange.context = parts.port.context
        self._carry = self._in_c if native and self._has_header != is_line else self._in_python

    def ask(
        self, unit: int, request: Request[Any], patience: Patience, waker: int, is_ready: IsReady
    ) -> tuple[Batch | None, Any]:
        """
        Send a request and take its answer.

        Args:
            waker: a descriptor that is readable when the wait must end.
            is_ready: waits so many seconds for something to read; raises Woken then.

        Returns:
            None and the result; or what the conversation must go on with, and why the
            connection is lost, if it is.

        Raises:
            TypeError, ValueError: the request cannot be sent.
        """
        pdu = encoded(request, "request", 0, False)
        if pdu[0] not in KNOWN:
            return self._hand_over(unit, request, patience), None
        number = self._conversation.next_number()
        if not self._has_header:
            self._wait_for_silence()
        now = monotonic()
        try:
            answer = self._carry(unit, number, pdu, patience.timeout, waker, is_ready)
            if answer is None:
                return self._hand_over(unit, request, patience), None
            if answer:
                outcome = request.decode_response(answer)
                self._note_success()
                return None, outcome
        except ModbusError:
            pass  # the conversation tells it all that was asked
        except BaseException:  # Ctrl-C: it was sent, and nobody waits any more
            batch = self._adopted(unit, number, request, patience, now)
            self._conversation.abandon(batch, now)
            raise
        batch = self._adopted(unit, number, request, patience, now)
        if self._error is not None:
            return batch, self._error
        if self._data:
            self._conversation.take(self._data, monotonic())
            self._conversation.settle(monotonic())
        return batch, None

    def _hand_over(self, unit: int, request: Request[Any], patience: Patience) -> Batch:
        batch = Batch(unit, [request], patience)
        self._conversation.add(batch, monotonic())
        return batch

    def _adopted(
        self, unit: int, number: int, request: Request[Any], patience: Patience, now: float
    ) -> Batch:
        batch = Batch(unit, [request], patience)
        adu = self._encode(Frame(unit, batch.pdus[0], number))
        self._conversation.adopt(batch, adu, now)
        return batch

    def _wait_for_silence(self) -> None:
        if (left := self._port.silence.over_at - monotonic()) > 0:
            time.sleep(left)

    def _in_c(
        self, unit: int, number: int, pdu: bytes, timeout: float, waker: int, _: IsReady
    ) -> bytes | None:
        """Give the answer; nothing if what came must be looked at; None if nothing was sent."""
        exchange = self._exchange
        size = lib.exchange(
            exchange, self._port.descriptor, waker, unit, number, pdu, len(pdu), timeout
        )
        if size > 0:
            self._data = self._answer[: 7 + size]
            return self._data[7:]
        self._data = self._answer[: exchange.got]
        self._error = _lost(exchange.error)
        return None if size < 0 else self._answer_on_line(unit)

    def _in_python(
        self, unit: int, number: int, pdu: bytes, timeout: float, _: int, is_ready: IsReady
    ) -> bytes | None:
        """The same without C."""
        port = self._port
        self._data, self._error = b"", None
        if port.has_input():
            return None
        try:
            port.send([self._encode(Frame(unit, pdu, number))], monotonic())
            if port.resume_at is None and is_ready(timeout):
                self._data = b"".join(port.receive())
        except ModbusConnectionError as error:
            self._error = error
            return b""
        except Woken:  # again, as long as nobody closes
            return b""
        if not self._has_header:
            return self._answer_on_line(unit)
        # One whole frame: id, protocol 0, length, unit.
        data = self._data
        prefix = mbap(number, unit, data[7:])
        return data[7:] if len(data) > 7 and data[:7] == prefix[:7] else b""

    def _answer_on_line(self, unit: int) -> bytes:
        data = self._data
        is_whole = len(data) > 4 and data[0] == unit and not self._has_header and not crc16(data)
        return data[1:-2] if is_whole else b""

    def _note_success(self) -> None:
        now = monotonic()
        statistics = self._statistics
        statistics.requests += 1
        statistics.responses += 1
        statistics.last_success = now
        if self._connection.fruitless:
            self._connection.prove()
        if not self._has_header:
            self._port.silence.heard(now)


def _lost(number: int) -> ModbusConnectionError | None:
    return lost(OSError(number, os.strerror(number))) if number else None
