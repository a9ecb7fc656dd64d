"""Slaves by hand, as in C: receive a request, answer it from a mapping or with an exception."""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections import deque
from typing import Any

from ..binding.library import check, ffi, lib
from ..device.access import touched
from ..device.mapping import Mapping
from ..protocol import pdu
from ..protocol.checks import integer
from ..protocol.errors import ExceptionResponse, FrameError, ModbusError, ModbusTimeoutError
from ..protocol.frames import Frame, Framer, Overheard
from ..protocol.framing import is_one_frame
from ..protocol.scan import is_one_adu
from .context import BUSY
from .functions import Functions

ANSWERED = frozenset((1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The functions that modbus_reply answers; all others it refuses, after it has slept."""

LARGEST = max(lib.MODBUS_TCP_MAX_ADU_LENGTH, lib.MODBUS_RTU_MAX_ADU_LENGTH)


class Slave(Functions):
    """The methods of a slave."""

    _framer: Framer | None = None

    def __init__(self, modbus: Any, unit: int, timeout: float) -> None:
        self._requests: deque[Frame | FrameError] = deque()
        super().__init__(modbus, unit, timeout)

    def receive(self) -> bytes | None:
        """
        Wait for a request, and return its whole frame.

        None for a request that is not for this slave, as modbus_receive returns 0: on a serial line
        one to another unit. On TCP all units are received.

        This package splits what it reads by the length in the header, or by the CRC: modbus_receive
        takes the rest of a request of a function that it does not know for the next request.

        Raises:
            FrameError: the bytes are no frame (EMBBADCRC); receive again, on TCP `accept` again.
            ModbusTimeoutError: nothing came within `indication_timeout`, if that is set.
            ModbusConnectionError: the master has closed the connection, or there is none.
        """
        with self._lock, self._errors():
            self._ensure_open()
            state, self._state = self._state, BUSY
            try:
                return self._next_request()
            except ModbusError as error:
                if not (self._is_serial or isinstance(error, ModbusTimeoutError)):
                    self._drop()
                raise
            finally:
                if self._state is BUSY:
                    self._state = state

    def reply(self, request: bytes, mapping: Mapping) -> int:
        """
        Answer a request from a mapping (modbus_reply), and return the number of bytes sent.

        A wrong request is refused here, because modbus_reply reads past the end of short requests,
        and sleeps after an illegal quantity or function. Requests of a code of 80h or more, and
        those to unit 0 of a serial line, which are carried out, get no answer: 0 is returned.

        Args:
            request: a frame as `receive` returns it.
            mapping: the tables; addresses in holes are refused, too.

        Raises:
            TypeError, ValueError: the request is no such frame.
            ModbusConnectionError: the answer cannot be sent.
        """
        if not isinstance(mapping, Mapping):
            raise TypeError(f"mapping must be a Mapping, not {type(mapping).__name__}")
        _, data = self._parts(request)
        code = _refusal(data, mapping)
        if code:
            return self.reply_exception(request, code)
        with mapping.lock:
            size = len(request)
            return self._answer(
                request,
                lambda buffer: lib.modbus_reply(
                    self._modbus, buffer, size, ffi.addressof(mapping._struct, "tables")
                ),
            )

    def reply_exception(self, request: bytes, code: int) -> int:
        """
        Refuse a request (modbus_reply_exception), and return the number of bytes sent.

        Args:
            request: a frame as `receive` returns it; 0 is returned where `reply` does.
            code: the exception code, 1..11, such as ``IllegalDataAddress.code``.

        Raises: as `reply`.
        """
        number = integer("code", code, 1, lib.MODBUS_EXCEPTION_MAX - 1)
        unit, data = self._parts(request)
        if data[0] & 0x80 or (self._is_serial and unit == 0):
            return 0
        return self._answer(
            request, lambda buffer: lib.modbus_reply_exception(self._modbus, buffer, number)
        )

    def _next_request(self) -> bytes | None:
        timeout = self.indication_timeout
        deadline = time.monotonic() + timeout if timeout else math.inf
        framer = self._framer = self._framer or self._server_framer()
        while True:
            while self._requests:
                frame = self._requests.popleft()
                if isinstance(frame, FrameError):
                    raise frame
                if not isinstance(frame, Overheard):
                    is_other = self._is_serial and frame.unit not in (0, self.unit)
                    return None if is_other else framer.encode(frame)
            self._requests.extend(self._receive_frames(framer, deadline))

    def _answer(self, request: bytes, action: Any) -> int:
        # Zeroed, and as long as the longest: libmodbus looks where a short request has no bytes.
        buffer = ffi.new("uint8_t[]", LARGEST)
        ffi.memmove(buffer, request, len(request))
        with self._lock, self._errors():
            self._ensure_open()
            if self._framer is not None:
                self._framer.note_answer()
            try:
                return check(action(buffer))
            except ModbusError:
                self._drop()  # a part of the answer may have been sent
                raise

    def _parts(self, request: bytes) -> tuple[int, bytes]:
        if not isinstance(request, bytes):
            raise TypeError(f"request must be bytes, not {type(request).__name__}")
        if not (is_one_adu if self._is_serial else is_one_frame)(request):
            raise ValueError("request must be a whole frame, as receive() returns it")
        head = self.header_length
        return request[head - 1], request[head : -2 if self._is_serial else None]

    @abstractmethod
    def _server_framer(self) -> Framer: ...


def _refusal(data: bytes, mapping: Mapping) -> int:
    """Return the exception code for a PDU that cannot be answered from a mapping; else 0."""
    if data[0] not in ANSWERED:
        return int(lib.MODBUS_EXCEPTION_ILLEGAL_FUNCTION)
    try:
        writes, reads = touched(pdu.decode_request(data), mapping=mapping)
    except ExceptionResponse as refusal:
        return refusal.code
    exist = all(getattr(mapping, at.table).has(at.address, at.count) for at in writes + reads)
    return 0 if exist else int(lib.MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS)
