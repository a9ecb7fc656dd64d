"""
The short way for a single request whose answer can only be its own, through C or without.

A way around the conversation while that has nothing to say: nothing in flight, nothing
half received, no late answer that may still come. What is not plainly the answer is handed
over to the conversation with all received bytes; the conversation goes on waiting.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any, Protocol

from ..binding.library import ffi, lib
from ..ports.port import Port, lost
from ..ports.waiting import LONGEST, Waker, Woken
from ..protocol.errors import ModbusConnectionError, ModbusError
from ..protocol.framing import pdu_with_crc
from ..protocol.pdu import Request
from .batch import Batch
from .plain_answers import PlainAnswers

if TYPE_CHECKING:
    from .options import Parts
    from .timeouts import Timeouts

__all__ = ["Carrier", "NativeCarrier", "Shortcut"]

# Around a PDU on a line, at least: a unit and a CRC.
LEAST_AROUND = 3


class Carrier(Protocol):
    """
    Looks for unasked bytes, sends a request, waits, and reads once.

    Attributes:
        received: the bytes that came, datagram by datagram.
        error: why the connection is lost, or None.
    """

    @property
    def received(self) -> list[bytes]: ...

    @property
    def error(self) -> ModbusConnectionError | None: ...

    def carry(self, unit: int, number: int, pdu: bytes, timeout: float, waker: int) -> bytes | None:
        """
        Return the PDU of the answer; an empty one if the conversation must look at what came, or
        nothing did; None if nothing was sent.

        Args:
            waker: a descriptor that is readable when the wait must end.
        """


class PythonCarrier:
    """See `Carrier`."""

    def __init__(self, port: Port, answers: PlainAnswers, waker: Waker) -> None:
        self.received: list[bytes] = []
        self.error: ModbusConnectionError | None = None
        self._port = port
        self._answers = answers
        self._waker = waker

    def carry(self, unit: int, number: int, pdu: bytes, timeout: float, waker: int) -> bytes | None:
        self.received, self.error = [], None
        if self._port.has_input():
            return None
        try:
            self._port.send([self._answers.frame(number, unit, pdu)], self._waker.now())
            is_sent = self._port.resume_at is None and not self._port.has_unsent
            if is_sent and self._waker.is_ready(timeout):
                self.received = self._port.receive()
        except ModbusConnectionError as error:
            self.error = error
        except Woken:  # once more, when the conversation waits
            pass
        data = self.received[0] if len(self.received) == 1 else b""
        return self._answers.pdu_in(data, unit, number)


class NativeCarrier:
    """
    See `Carrier`. One call of C, without the GIL; on serial lines libmodbus sends.

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


class Shortcut:
    """
    Carries single requests where frames show by themselves that they are whole.

    Args:
        parts: of the client.
        native: True to let C do it, where it can.
        waker: what the other way waits with.
    """

    def __init__(self, parts: Parts, native: bool, waker: Waker) -> None:
        self._answers = PlainAnswers(parts)
        self._waker = waker
        self._now = waker.now
        self._port = parts.port
        self._silence = parts.port.silence
        self._conversation = parts.conversation
        self._matching = parts.matching
        self._statistics = parts.statistics
        self._is_line = self._answers.is_line
        # What was sent, and not yet handed over or answered.
        self._sent: tuple[int, int, Request[Any], bytes, Timeouts, float] | None = None
        self._carrier: Carrier
        in_clear = not parts.endpoint.is_secure  # C reads and writes the descriptor itself
        if native and in_clear and (not self._is_line or parts.port.context is not None):
            self._carrier = NativeCarrier(parts.port)
        else:
            self._carrier = PythonCarrier(parts.port, self._answers, waker)

    def ask(
        self, unit: int, request: Request[Any], pdu: bytes, timeouts: Timeouts, waker: int
    ) -> tuple[Batch | None, Any]:
        """
        Send a request and take its answer.

        Args:
            request: one that is answered; `pdu` is what it encodes to, of a function in `KNOWN`.
            waker: a descriptor that is readable when the wait must end.

        Returns:
            None and the outcome; or what the conversation must go on with, and why the
            connection is lost, if it is.
        """
        number = 0 if self._is_line else self._matching.next_number()
        since = self._now()
        if self._is_line:
            if (left := self._silence.over_at - since) > 0:
                self._waker.sleep(left)
                since = self._now()
            self._silence.sent(len(pdu) + LEAST_AROUND, since)
        self._sent = unit, number, request, pdu, timeouts, since
        answer = self._carrier.carry(unit, number, pdu, timeouts.timeout, waker)
        if answer is None:
            self._sent = None
            batch = Batch(unit, [request], timeouts, pdus=[pdu])
            self._conversation.add(batch, self._now())
            return batch, None
        now = self._now()
        if answer and (not self._is_line or self._matching.accepts(unit, pdu, answer, since, now)):
            try:
                outcome = request.decode_response(answer)
            except ModbusError:
                pass  # the conversation meets it again, and tells it all that was asked
            except BaseException as mistake:
                self._conclude(pdu, since, now, "invalid")
                return None, mistake
            else:
                self._conclude(pdu, since, now, "ok")
                return None, outcome
        batch = self._hand_over()
        if self._carrier.error is None:
            now = self._now()
            self._conversation.take(self._carrier.received, now)
            self._conversation.settle(now)
        return batch, self._carrier.error

    def interrupt(self) -> None:
        """Let the conversation know of a request that was sent, and whose caller is gone."""
        if self._sent is not None:
            self._hand_over()

    def _conclude(self, pdu: bytes, since: float, now: float, result: str) -> None:
        """Note the answer to the request, whatever its class made of it."""
        self._sent = None
        self._statistics.requests += 1
        if result == "ok":
            self._conversation.note_answer(pdu[0], result, now - since, now)
        else:
            self._statistics.note(pdu[0], result)
        if self._is_line:
            self._silence.heard(now)

    def _hand_over(self) -> Batch:
        """Return a batch of the request that was sent, whose answer the conversation expects."""
        assert self._sent is not None
        unit, number, request, pdu, timeouts, since = self._sent
        batch = Batch(unit, [request], timeouts, pdus=[pdu])
        adu = self._answers.frame(number, unit, pdu)
        self._statistics.requests += 1
        self._conversation.adopt(batch, adu, since)
        self._sent = None
        return batch
