"""
One connection and the transactions on it: one at a time, through libmodbus or
without, or many in flight (`pipeline`), without.

libmodbus carries a request when it can be trusted to get the answer right. The
way around it, with the framers of this package on the same descriptor, is for
what libmodbus lacks or does not check:

* functions and framings it does not have;
* the first answer of every unit and function on a connection, for it looks at
  neither the unit nor the echo of answers on TCP;
* after a failure, until an answer came: a late answer makes it refuse every
  later one on TCP, and on RTU it takes the late one for the next;
* an exception whose code it does not know, for it does not tell the code.
"""

from __future__ import annotations

import errno
import os
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from ..binding.library import UnnamedException, check, lib
from ..ports.link import TIMEOUTS_BEFORE_RECONNECT, Link
from ..protocol.errors import (
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)
from ..protocol.framing import Frame, Framer
from ..protocol.pdu import Request
from .native import NATIVE, Call
from .pipeline import Pipeline

__all__ = ["Line"]

Result = TypeVar("Result")

# More requests than this without an answer, and the connection is made anew: their
# ids could not be used again.
MAX_ABANDONED = 1024


class Line:
    """
    Args:
        link: the TCP connection or the serial port.
        make_framer: makes the framer of a new connection.
        timeout: seconds for one transaction, connecting included.
        turnaround: seconds that a broadcast takes.
        native: True lets libmodbus carry all it knows, False nothing, None
            all that has been answered rightly once.
        speaks: whether libmodbus speaks this framing on this link.

    Attributes:
        late_answers: how many answers came after their timeout and were dropped.
    """

    def __init__(
        self,
        link: Link,
        make_framer: Callable[[], Framer],
        *,
        timeout: float,
        turnaround: float,
        native: bool | None,
        speaks: bool,
    ) -> None:
        self.late_answers = 0
        self.turnaround = turnaround
        self.timeout = timeout
        self._link = link
        self._make_framer = make_framer
        self._framer = make_framer()
        self._native = native
        self._calls = NATIVE if speaks and native is not False else {}
        self._lock = threading.Lock()
        self._closed = False
        self._timeouts = 0
        self._native_sent = 0  # libmodbus counts its transaction ids like this: 1, 2..65535, 0
        self._python_sent = 0
        self._abandoned: set[int] = set()  # ids of `execute_many` that may still be answered
        self._adu = b""
        self._received = bytearray()
        self._distrust()
        self._in_doubt = False
        _lines.add(self)
        weakref.finalize(self, link.close)

    @property
    def closed(self) -> bool:
        return self._closed

    def open(self) -> None:
        """Connect, unless connected. Raises ModbusConnectionError."""
        with self._lock:
            self._open()

    def close(self) -> None:
        """Close for good. A transaction that another thread waits for ends first."""
        self._closed = True
        self._link.interrupt()
        with self._lock:
            self._link.close()

    def execute(self, unit: int, request: Request[Result]) -> Result:
        """
        Send a request and give the result of its answer.

        Raises:
            ModbusError: with everything about the transaction.
            TypeError: not a request.
            ValueError: a broadcast of what is no write.
        """
        self.check(unit, request, "request")
        with self._lock:
            self._adu = b""
            self._received.clear()
            try:
                result: Result = self._execute(unit, request)
            except ModbusError as error:
                self._note(error, unit, request)
                raise
            except BaseException:  # Ctrl-C: the answer is still to come
                self._distrust()
                raise
            self._in_doubt = False
            self._timeouts = 0
            return result

    def check(self, unit: int, request: object, name: str) -> None:
        """Raises TypeError, ValueError as `execute` does."""
        if not isinstance(request, Request):
            raise TypeError(f"{name} must be one of pdu, not {type(request).__name__}")
        if unit == 0 and self._framer.has_broadcast and not request.is_write:
            raise ValueError(
                f"{name}: unit 0 is a broadcast, which nobody answers, and {request} is no write"
            )

    def can_pipeline(self, requests: Sequence[Request[Any]]) -> bool:
        """Whether answers can be told apart, and all of the requests get one."""
        return not self._framer.has_broadcast and all(each.expects_response for each in requests)

    def execute_many(
        self,
        unit: int,
        requests: Sequence[Request[Any]],
        *,
        max_in_flight: int,
        tolerated: tuple[type[ModbusError], ...],
    ) -> list[Any]:
        """
        Send requests that were checked, many at a time.

        Returns:
            The result or the ModbusError of each; where one is not `tolerated`, what
            comes after it may be missing (None).
        """
        with self._lock:
            batch = Pipeline(
                unit,
                requests,
                max_in_flight=max_in_flight,
                timeout=self.timeout,
                tolerated=tolerated,
                next_transaction=self._next_transaction,
                abandoned=self._abandoned,
            )
            try:
                while not batch.is_done:
                    self._carry(batch)
            finally:
                batch.leave()
                self.late_answers += batch.late_answers
                self._in_doubt = batch.had_trouble or self._framer.pending > 0
                if self._in_doubt:
                    self._distrust()
            return batch.outcomes

    def _carry(self, batch: Pipeline) -> None:
        try:
            self._open()
            self._clear_line()
            batch.timeouts = self._timeouts
            batch.run(self._link, self._framer)
            self._timeouts = batch.timeouts
        except ModbusError as error:
            self._link.close()
            batch.lose(error)
        except BaseException:  # Ctrl-C: who knows what went out
            self._link.close()
            raise

    def _execute(self, unit: int, request: Request[Any]) -> Any:
        self._open()
        if (unit == 0 and self._framer.has_broadcast) or not request.expects_response:
            return self._tell(unit, request)
        call = self._native_call(unit, request)
        if call is not None:
            try:
                return self._execute_native(call, unit, request)
            except UnnamedException:
                # A refused request changed nothing, and all that libmodbus
                # carries sets absolute values: it can be asked again.
                pass
        return self._exchange(unit, request)

    def _note(self, error: ModbusError, unit: int, request: Request[Any]) -> None:
        """Complete the error, and remember what it means for the next transaction."""
        error.unit, error.function, error.asked = unit, request.function, str(request)
        error.sent = error.sent or self._adu
        error.received = bytes(self._received) or error.received
        if isinstance(error, ExceptionResponse):
            self._in_doubt = False
            self._timeouts = 0
            return
        self._distrust()
        if isinstance(error, ModbusTimeoutError):
            self._timeouts += 1
        if isinstance(error, ModbusConnectionError) or not self._framer.in_step:
            self._link.close()

    def _distrust(self) -> None:
        self._trusted: set[tuple[int, int]] = set()
        self._failed_at = time.monotonic()

    # --- the connection --------------------------------------------------------------

    def _open(self) -> None:
        if self._closed:
            raise ModbusConnectionError("this context is closed", errno=errno.EBADF)
        if self._timeouts >= TIMEOUTS_BEFORE_RECONNECT and self._link.can_die_silently:
            self._link.close()
        if len(self._abandoned) > MAX_ABANDONED:
            self._link.close()
        if self._link.is_open:
            return
        self._timeouts = 0
        self._abandoned.clear()
        self._link.open(time.monotonic() + self.timeout)
        self._link.prepare(self.timeout)
        self._framer = self._make_framer()
        self._slave = -1
        self._distrust()

    def _reopen(self) -> None:
        self._link.close()
        self._open()

    def set_timeout(self, timeout: float) -> None:
        with self._lock:
            self.timeout = timeout
            if self._link.is_open:
                self._link.prepare(timeout)

    def forget(self) -> None:
        """After a fork, in the child: the connection is the parent's."""
        self._lock = threading.Lock()
        self._link.abandon()

    # --- through libmodbus ---------------------------------------------------------------

    def _native_call(self, unit: int, request: Request[Any]) -> Call | None:
        call = self._calls.get(type(request))
        if call is None or self._in_doubt or self._abandoned or not self._link.native:
            return None
        if self._native is None and (unit, request.function) not in self._trusted:
            return None
        if 247 < unit < 255 or (self._framer.has_broadcast and unit == 255):
            return None  # modbus_set_slave refuses these
        # Bytes nobody asked for, or the end of the connection.
        return None if self._link.has_input() else call

    def _execute_native(self, call: Call, unit: int, request: Request[Any]) -> Any:
        if unit != self._slave:
            check(lib.modbus_set_slave(self._link.context, unit))
            self._slave = unit
        self._in_doubt = True
        self._native_sent += 1
        self._link.wait_for_silence()
        try:
            return call(self._link.context, request)
        except ModbusError as error:
            self._adu = self._native_adu(unit, request.encode())
            if isinstance(error, ModbusTimeoutError):
                raise self._timeout() from None
            if isinstance(error, ExceptionResponse):
                refusal = bytes([request.function | 0x80, error.code])
                self._received += self._native_adu(unit, refusal)
            raise
        finally:
            self._link.note_traffic()

    def _native_adu(self, unit: int, pdu: bytes) -> bytes:
        return self._framer.encode(Frame(unit, pdu, self._native_sent & 0xFFFF))

    # --- without it ------------------------------------------------------------------------

    def _exchange(self, unit: int, request: Request[Any]) -> Any:
        self._clear_line()
        deadline = time.monotonic() + self.timeout
        sent = self._send(unit, request, deadline)
        answer = self._await(sent, deadline)
        result = request.decode_response(answer)
        if not self._framer.pending:
            self._trusted.add((unit, request.function))
        return result

    def _tell(self, unit: int, request: Request[Any]) -> None:
        """Send what nobody answers, and give time to act on it."""
        self._clear_line()
        self._send(unit, request, time.monotonic() + self.timeout)
        time.sleep(self.turnaround)

    def _send(self, unit: int, request: Request[Any], deadline: float) -> Frame:
        self._in_doubt = True
        transaction = 0 if self._framer.has_broadcast else self._next_transaction()
        frame = Frame(unit, request.encode(), transaction)
        self._adu = self._framer.encode(frame)
        self._link.wait_for_silence()
        if self._framer.has_broadcast:
            self._link.discard_input()  # what came while we waited is late, too
        self._link.send(self._adu, deadline)
        return frame

    def _next_transaction(self) -> int:
        while True:
            self._python_sent += 1
            # Half the circle away from libmodbus's own ids, so that neither can
            # meet a late answer of the other.
            transaction = self._native_sent + 0x8000 + self._python_sent % 0x4000 & 0xFFFF
            if transaction not in self._abandoned:
                return transaction

    def _clear_line(self) -> None:
        """Get rid of late answers and garbage before a request goes out."""
        try:
            if self._framer.has_broadcast:
                self._drop_input()
            else:
                self._skip_late_answers()
        except ModbusConnectionError:  # closed while nobody asked anything
            self._reopen()

    def _drop_input(self) -> None:
        if self._in_doubt:
            self._wait_for_quiet()
        self._link.discard_input()
        self._framer = self._make_framer()
        if self._link.has_input():  # not bytes, then: the other side has closed
            self._reopen()

    def _skip_late_answers(self) -> None:
        limit = time.monotonic() + self.timeout
        while (flood := self._link.has_input()) and time.monotonic() < limit:
            self._drop_late(self._framer.scan(self._link.receive(0)))
        if self._framer.pending or not self._framer.in_step or flood:
            self._reopen()

    def _drop_late(self, found: Sequence[Frame | FrameError]) -> None:
        for each in found:
            if isinstance(each, Frame):
                self.late_answers += 1
                self._abandoned.discard(each.transaction)

    def _wait_for_quiet(self) -> None:
        """
        Let a late answer pass: nothing in it would tell that it is none of ours.

        Raises:
            FrameError: the line does not fall silent.
        """
        limit = time.monotonic() + 2 * self.timeout
        quiet_at = self._failed_at + self.timeout
        late = bytearray()
        while (now := time.monotonic()) < quiet_at:
            if now > limit:
                self._received += late
                raise FrameError("the line does not fall silent")
            if data := self._link.receive(quiet_at):
                late += data
                quiet_at = time.monotonic() + self.timeout
        self.late_answers += bool(late)

    def _await(self, sent: Frame, deadline: float) -> bytes:
        """Give the PDU that answers."""
        wrong: ModbusError | None = None
        while True:
            data = self._link.receive(self._next_look(wrong, deadline))
            self._received += data
            if not data and not wrong and time.monotonic() >= deadline:
                raise self._timeout()
            found = self._framer.scan(data) if data else self._framer.scan_silence()
            for at, each in enumerate(found, start=1):
                if isinstance(each, FrameError):
                    # A damaged datagram says nothing about the next one.
                    wrong = wrong if self._link.datagrams else each
                elif each.transaction != sent.transaction:
                    self._drop_late([each])
                elif each.unit == sent.unit:
                    self._drop_late(found[at:])
                    return each.pdu
                else:
                    wrong = InvalidResponse(f"unit {each.unit} answered")
            if time.monotonic() >= deadline or (wrong and self._is_final(wrong, data)):
                raise wrong or self._timeout()

    def _next_look(self, wrong: ModbusError | None, deadline: float) -> float:
        if self._framer.quiet and (self._framer.pending or wrong):
            return min(deadline, time.monotonic() + self._framer.quiet)
        return deadline

    def _is_final(self, wrong: ModbusError, data: bytes) -> bool:
        """Whether nothing better can come."""
        if not self._framer.has_broadcast:
            return True
        # On a serial line a good answer may follow noise, and another unit's
        # answer does not end the wait (serial line, 2.4.1).
        return isinstance(wrong, FrameError) and not (data and self._framer.pending)

    def _timeout(self) -> ModbusTimeoutError:
        if self._received:
            return ModbusTimeoutError(
                f"no complete answer within {self.timeout:g} s, but {self._received.hex(' ')}"
            )
        return ModbusTimeoutError(f"no answer within {self.timeout:g} s")


_lines: weakref.WeakSet[Line] = weakref.WeakSet()


def _forget_all() -> None:
    for line in _lines:
        line.forget()


os.register_at_fork(after_in_child=_forget_all)
