"""
The functions of Modbus as methods: those of libmodbus, and those that it lacks; slaves by hand, as
in C: receive a request, answer it from a mapping or with an exception.
"""

from __future__ import annotations

import math
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from ..binding.library import check, ffi, lib
from ..device.access import touched
from ..device.mapping import Mapping
from ..ports.options import CLIENT_OPTIONS
from ..ports.waiting import READ
from ..protocol import errors, pdu
from ..protocol.checks import integer
from ..protocol.frames import Frame, Framer, OverheardResponse
from ..protocol.framing import is_one_frame
from ..protocol.scan import is_one_adu
from ..protocol.tables import TABLE_SIZE
from .context import BUSY, READY, ContextBase

Result = TypeVar("Result")

_unpack = ffi.unpack


class Functions(ContextBase):
    """One method for each function; addresses are 0-based, 0..65535."""

    def read_coils(self, address: int, count: int) -> list[bool]:
        """Read 1..2000 coils (function 1, modbus_read_bits)."""
        kind, function = pdu.ReadCoils, lib.modbus_read_bits
        return list(map(bool, self._read(kind, function, self._bits, address, count)))

    def read_discrete_inputs(self, address: int, count: int) -> list[bool]:
        """Read 1..2000 discrete inputs (function 2, modbus_read_input_bits)."""
        kind, function = pdu.ReadDiscreteInputs, lib.modbus_read_input_bits
        return list(map(bool, self._read(kind, function, self._bits, address, count)))

    def read_holding_registers(self, address: int, count: int) -> list[int]:
        """Read 1..125 holding registers (function 3, modbus_read_registers)."""
        return self._read(HOLDING_REGISTERS, READ_REGISTERS, self._registers, address, count)

    def read_input_registers(self, address: int, count: int) -> list[int]:
        """Read 1..125 input registers (function 4, modbus_read_input_registers)."""
        kind, function = pdu.ReadInputRegisters, lib.modbus_read_input_registers
        return self._read(kind, function, self._registers, address, count)

    def write_coil(self, address: int, value: bool) -> None:
        """Write one coil (function 5, modbus_write_bit)."""
        request = pdu.WriteCoil(address, value)
        self._write(request, lib.modbus_write_bit, request.address, request.value)

    def write_register(self, address: int, value: int) -> None:
        """Write one holding register, 0..65535 (function 6, modbus_write_register)."""
        request = pdu.WriteRegister(address, value)
        self._write(request, lib.modbus_write_register, request.address, request.value)

    def write_coils(self, address: int, values: Iterable[bool]) -> None:
        """Write 1..1968 coils (function 15, modbus_write_bits)."""
        request = pdu.WriteCoils(address, values)  # type: ignore[arg-type]
        bits = bytes(request.values)
        self._write(request, lib.modbus_write_bits, request.address, len(bits), bits)

    def write_registers(self, address: int, values: Iterable[int]) -> None:
        """Write 1..123 holding registers, each 0..65535 (function 16, modbus_write_registers)."""
        request = pdu.WriteRegisters(address, values)  # type: ignore[arg-type]
        words = request.values
        self._write(request, lib.modbus_write_registers, request.address, len(words), words)

    def mask_write_register(self, address: int, and_mask: int, or_mask: int) -> None:
        """
        Set a holding register to (current AND and_mask) OR (or_mask AND NOT and_mask); both masks
        are 0..65535 (function 22, modbus_mask_write_register).
        """
        request = pdu.MaskWriteRegister(address, and_mask, or_mask)
        masks = request.and_mask, request.or_mask
        self._write(request, lib.modbus_mask_write_register, request.address, *masks)

    def read_write_registers(
        self, read_address: int, read_count: int, write_address: int, values: Iterable[int]
    ) -> list[int]:
        """Write 1..121 registers, then read 1..125 (23, modbus_write_and_read_registers)."""
        request = pdu.ReadWriteRegisters(read_address, read_count, write_address, values)  # type: ignore[arg-type]
        writing = request.write_address, len(request.values), request.values
        read = request.read_address, request.read_count, self._registers

        def act() -> list[int]:
            check(lib.modbus_write_and_read_registers(self._modbus, *writing, *read))
            words: list[int] = _unpack(self._registers, request.read_count)
            return words

        return self._transact(request, act)

    def report_server_id(self) -> pdu.ServerId:
        """
        Read the identifier and the run status of the device (function 17, modbus_report_slave_id).

        The response is split after an identifier of one byte; ``pdu.ServerId.split(result.data,
        length)`` splits it for a longer one.
        """

        def act() -> pdu.ServerId:
            size = check(lib.modbus_report_slave_id(self._modbus, len(self._bits), self._bits))
            if size < 2:
                raise errors.InvalidResponse(f"answered with {size} bytes of data")
            return pdu.ServerId.split(bytes(_unpack(self._bits, size)))

        return self._transact(pdu.ReportServerId(), act)

    # --- functions that libmodbus lacks ------------------------------------------------------

    def execute(self, request: pdu.Request[Result]) -> Result:
        """
        Send any request, an object of `libmodbus_py.pdu` or of a class of the program; return its
        result, or None for a broadcast.

        libmodbus sends it (modbus_send_raw_request); this package receives and checks the answer:
        its unit, too, and all that its class checks.
        """
        if not isinstance(request, pdu.Request):
            raise TypeError(f"request must be a Request of pdu, not {type(request).__name__}")
        request_pdu = request.encode()
        result: Result = self._transact(request, lambda: self._exchange(request, request_pdu))
        return result

    def read_exception_status(self) -> int:
        """Read the eight exception status outputs, lowest in bit 0 (function 7)."""
        return self.execute(pdu.ReadExceptionStatus())

    def diagnostics(self, sub_function: int, data: int = 0) -> int:
        """
        Run a diagnostic sub-function, `pdu.SubFunction`, with data of 0..65535 (function 8); return
        the data of the response, or `data` itself if the sub-function gets none.
        """
        word = integer("data", data, 0, 0xFFFF).to_bytes(2, "big")
        answer = self.execute(pdu.Diagnostics(sub_function, word))
        return data if answer is None else int.from_bytes(answer, "big")

    def read_comm_event_counter(self) -> pdu.CommEventCounter:
        """Read the status word and the event counter (function 11)."""
        return self.execute(pdu.ReadCommEventCounter())

    def read_comm_event_log(self) -> pdu.CommEventLog:
        """Read the counters and up to 64 events, newest first (function 12)."""
        return self.execute(pdu.ReadCommEventLog())

    def read_file_records(self, records: Sequence[tuple[int, int, int]]) -> list[list[int]]:
        """
        Read records of files (function 20): 1..35 tuples (file 1..65535, first record 0..9999,
        number of records 1..124), which together must fit into one response.
        """
        return self.execute(pdu.ReadFileRecords(records))  # type: ignore[arg-type]

    def write_file_records(self, records: Sequence[tuple[int, int, Iterable[int]]]) -> None:
        """
        Write records of files (function 21): tuples (file 1..65535, first record 0..9999, 1..122
        values of 0..65535), which together must fit into one request.
        """
        self.execute(pdu.WriteFileRecords(records))  # type: ignore[arg-type]

    def read_fifo_queue(self, address: int) -> list[int]:
        """Read the 0..31 registers of a FIFO queue without removing them (function 24)."""
        return self.execute(pdu.ReadFifoQueue(address))

    def read_device_identification(self, level: str | int = "basic") -> pdu.DeviceIdentification:
        """
        Read the identification of a device (function 43/14), with as many requests as needed.

        `level` is "basic", "regular" or "extended", or the id of a single object, 0..255. If a
        mandatory object is missing, an InvalidResponse says why.
        """
        from ..protocol.pdu.interface import identify

        steps = identify(level)
        with self._lock, self._errors():
            try:
                request = next(steps)
                while True:
                    request = steps.send(self.execute(request))
            except StopIteration as done:
                identification: pdu.DeviceIdentification = done.value
                return identification

    def encapsulated_transport(self, mei_type: int, data: bytes) -> bytes:
        """Send up to 251 bytes to the interface `mei_type`, 0..255, and receive such (43)."""
        return self.execute(pdu.EncapsulatedTransport(mei_type, data))

    def flush(self) -> int:
        """Discard unread bytes (modbus_flush); return their number, 0 on a serial line."""
        with self._lock:
            self._ensure_open()
            return self._discard_input()

    # --- how ---------------------------------------------------------------------------------

    def _read(self, kind: Any, function: Any, cells: Any, address: int, count: int) -> list[int]:
        """As `_transact`, without steps that few calls need: each read goes through here."""
        if not (
            type(address) is int
            and type(count) is int
            and 0 <= address <= TABLE_SIZE - count
            and 1 <= count <= kind.limit
        ):
            request = kind(address, count)
            address, count = request.address, request.count
        with self._lock:
            if self._state is not READY:
                try:
                    self._prepare()
                except errors.ModbusError as error:
                    self._describe(error, kind(address, count))
                    raise
            self._state = BUSY
            try:
                if function(self._modbus, address, count, cells) == count:
                    values: list[int] = _unpack(cells, count)
                    self._state = self._after
                    return values
                try:
                    check(-1)
                except errors.ModbusError as error:
                    self._judge(error)
                    self._describe(error, kind(address, count))
                    raise
                raise AssertionError
            finally:
                if self._state is BUSY:
                    self._spoil()

    def _write(self, request: pdu.Request[None], function: Callable[..., int], *data: Any) -> None:
        if self._is_serial and self.unit == 0:  # libmodbus would wait for an answer
            self.execute(request)
        else:
            self._transact(request, lambda: check(function(self._modbus, *data)))

    def _exchange(self, request: pdu.Request[Result], request_pdu: bytes) -> Any:
        self._discard_input()
        unit = self.unit
        body = bytes([unit]) + request_pdu
        check(lib.modbus_send_raw_request(self._modbus, body, len(body)))
        if self._is_serial and unit == 0:
            self._wait(-1, READ, time.monotonic() + CLIENT_OPTIONS["turnaround"].default)
            return None
        if not request.expects_response:
            return None
        framer = self._client_framer(request)
        frames = self._receive_frames(framer, time.monotonic() + self.response_timeout)
        frame = frames[0]
        if isinstance(frame, errors.FrameError):
            raise frame
        if frame.unit != unit or frame.transaction:  # libmodbus sends raw requests with id 0
            text = f"answered by unit {frame.unit} with id {frame.transaction}"
            raise errors.InvalidResponse(text)
        return request.decode_response(frame.pdu)

    @abstractmethod
    def _client_framer(self, request: pdu.Request[Any]) -> Framer: ...

    @abstractmethod
    def _discard_input(self) -> int: ...


HOLDING_REGISTERS, READ_REGISTERS = pdu.ReadHoldingRegisters, lib.modbus_read_registers
"""Of the most frequent request, found once."""


# --- slaves ---------------------------------------------------------------------------------

ANSWERED = frozenset((1, 2, 3, 4, 5, 6, 15, 16, 17, 22, 23))
"""The functions that modbus_reply answers; all others it refuses, after it has slept."""


class Slave(Functions):
    """The methods of a slave."""

    _framer: Framer | None = None

    def __init__(self, modbus: Any, unit: int, timeout: float) -> None:
        self._requests: deque[Frame | errors.FrameError] = deque()
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
            except errors.ModbusError as error:
                if not (self._is_serial or isinstance(error, errors.ModbusTimeoutError)):
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
        if code := _refusal(data, mapping):
            return self.reply_exception(request, code)
        tables = ffi.addressof(mapping._struct, "tables")
        with mapping.lock:
            return self._answer(request, lib.modbus_reply, len(request), tables)

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
        return self._answer(request, lib.modbus_reply_exception, number)

    def _next_request(self) -> bytes | None:
        timeout = self.indication_timeout
        deadline = time.monotonic() + timeout if timeout else math.inf
        framer = self._framer = self._framer or self._server_framer()
        while True:
            while self._requests:
                frame = self._requests.popleft()
                if isinstance(frame, errors.FrameError):
                    raise frame
                if not isinstance(frame, OverheardResponse):
                    is_other = self._is_serial and frame.unit not in (0, self.unit)
                    return None if is_other else framer.encode(frame)
            self._requests.extend(self._receive_frames(framer, deadline))

    def _answer(self, request: bytes, function: Callable[..., int], *arguments: Any) -> int:
        # Zeroed, and as long as the longest request: libmodbus reads beyond a short one.
        buffer = ffi.new("uint8_t[]", lib.MODBUS_TCP_MAX_ADU_LENGTH)
        ffi.memmove(buffer, request, len(request))
        with self._lock, self._errors():
            self._ensure_open()
            if self._framer is not None:
                self._framer.note_answer()
            try:
                return check(function(self._modbus, buffer, *arguments))
            except errors.ModbusError:
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
    except errors.ExceptionResponse as refusal:
        return refusal.code
    exist = all(getattr(mapping, at.table).has(at.address, at.count) for at in writes + reads)
    return 0 if exist else int(lib.MODBUS_EXCEPTION_ILLEGAL_DATA_ADDRESS)
