"""
The short way through C, for a request whose answer can only be its own.

A way around the conversation while that has nothing to say: nothing in flight, nothing
half received, no late answer that may still come. What is not plainly the answer is handed
over to the conversation, bytes and all, which goes on waiting and says what it was.
"""

from __future__ import annotations

import time
from time import monotonic
from typing import Any

from ..binding.library import exchange
from ..ports.port import Port
from ..ports.serial import SerialPort
from ..ports.waiting import milliseconds
from ..protocol.errors import ModbusError
from ..protocol.framing import crc16
from ..protocol.pdu import Request
from .batch import Batch, Patience
from .options import Parts

__all__ = ["KNOWN", "Shortcut"]

KNOWN = frozenset((1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The function codes that libmodbus has."""


class Shortcut:
    """
    Carries single requests on a TCP connection, or on a serial line in RTU mode.

    Args:
        parts: of the client.
    """

    def __init__(self, parts: Parts) -> None:
        self._port: Port = parts.port
        self._context = parts.port.context if isinstance(parts.port, SerialPort) else None
        self._conversation = parts.conversation
        self._connection = parts.connection
        self._statistics = parts.statistics

    def ask(
        self, unit: int, request: Request[Any], patience: Patience, waker: int
    ) -> tuple[Batch | None, Any]:
        """
        Send a request and take its answer.

        Args:
            waker: a descriptor that is readable when the wait must end.

        Returns:
            None and the result; or what the conversation must go on with, and None.

        Raises:
            TypeError, ValueError: the request cannot be sent.
        """
        conversation = self._conversation
        if not isinstance(request, Request) or request.function not in KNOWN:
            batch = Batch(unit, [request], patience)
            conversation.add(batch, monotonic())
            return batch, None
        pdu = request.encode()
        adu = conversation.next_adu(unit, pdu)
        self._wait_for_silence()
        now = monotonic()
        data = b""
        try:
            found = exchange(
                self._context,
                self._port.descriptor,
                waker,
                adu if self._context is None else adu[:-2],
                milliseconds(patience.timeout),
            )
            if found is None:
                batch = Batch(unit, [request], patience)
                conversation.add(batch, now)
                return batch, None
            data = found
            if data and (answer := self._answer_in(data, adu)):
                outcome = request.decode_response(answer)
                self._note(len(adu))
                return None, outcome
        except ModbusError:
            pass  # the conversation tells it all that was asked
        except BaseException:  # Ctrl-C: it was sent, and nobody waits any more
            batch = Batch(unit, [request], patience)
            conversation.adopt(batch, adu, now)
            conversation.abandon(batch, now)
            raise
        batch = Batch(unit, [request], patience)
        conversation.adopt(batch, adu, now)
        if data:
            conversation.take(data, monotonic())
            conversation.settle(monotonic())
        return batch, None

    def _wait_for_silence(self) -> None:
        over_at = self._port.silence.over_at
        if over_at and (left := over_at - monotonic()) > 0:
            time.sleep(left)

    def _answer_in(self, data: bytes, adu: bytes) -> bytes:
        """Give the PDU, if the bytes are one whole frame with the same id and unit."""
        if self._context is not None:
            return data[1:-2] if data[0] == adu[0] and len(data) > 4 and not crc16(data) else b""
        # One frame of TCP: id, protocol 0, length, unit.
        fits = data[:4] == adu[:4] and len(data) == 6 + int.from_bytes(data[4:6], "big")
        return data[7:] if fits and data[6] == adu[6] else b""

    def _note(self, size: int) -> None:
        now = monotonic()
        statistics = self._statistics
        statistics.requests += 1
        statistics.responses += 1
        statistics.last_success = now
        self._connection.prove()
        self._port.silence.heard(now)
