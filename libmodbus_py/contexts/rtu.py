"""Contexts on serial lines in RTU mode."""

from __future__ import annotations

import contextlib
import errno
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar, Literal

from ..binding.library import check, ffi, lib
from ..ports.options import Parity
from ..ports.serial import SerialPort
from ..ports.waiting import READ
from ..protocol.checks import checked_callback, finished, seconds
from ..protocol.errors import ModbusConnectionError, ModbusTimeoutError
from ..protocol.framing import RtuFramer
from ..protocol.mistakes import named_arguments
from ..protocol.pdu.request import Request
from ..protocol.rtu import has_own_length
from .context import CLOSED, OPEN, too_many_descriptors
from .functions import Slave

NOISE = 10
"""Response timeouts for which a line may be noisy after a failure, before that is an error."""

MODES: dict[str, int] = {"rs232": lib.MODBUS_RTU_RS232, "rs485": lib.MODBUS_RTU_RS485}

_failures: dict[str, float] = {}
"""Device -> the time of a failure: its line must be silent, also for another context."""

RtsMode = Literal["none", "up", "down"]

RTS: dict[RtsMode, int] = {
    "none": lib.MODBUS_RTU_RTS_NONE,
    "up": lib.MODBUS_RTU_RTS_UP,
    "down": lib.MODBUS_RTU_RTS_DOWN,
}


@named_arguments
class RtuContext(Slave):
    """
    A modbus_t on a serial port: each method is one call of libmodbus, which waits without the GIL.

    It opens the port when it is entered (``with``) or first used, and locks it, so that no two
    programs use it at once. After any failure but an ExceptionResponse the next request, also that
    of a new context, is not sent before the line was silent for one `response_timeout`. An answer
    that comes later than two timeouts after its request is taken for that to the next one, and so
    may those be that follow, because nothing in a frame tells. The timeout has to be longer than
    the slowest unit takes.
    Calls of other threads wait for each other. Ctrl-C takes effect when a call ends, at the latest
    after `response_timeout`. After a fork, the child has to make its own context; its parent's is
    not affected.

    libmodbus checks the CRC, unit, function and count of an answer; up to 3.1.7 not the echo of a
    write, and never that of a mask write. It has no retries, no ASCII, and removes no local echo.
    `Client` checks and has all of these.

    With `unit` 0, writes are broadcasts, which no unit answers.

    Every request can raise the exceptions that `TcpContext` names, and:

    * FrameError: the CRC of the answer is wrong (EMBBADCRC).
    * InvalidResponse: another unit answered (EMBBADSLAVE).

    Args:
        device: the path of the port, such as "/dev/ttyUSB0".
        baudrate: bits per second, 1..4000000, also where libmodbus would take 9600 in its place.
        parity: "N", "E" or "O".
        data_bits: 5..8.
        stop_bits: 1 or 2.
        unit: 0..247.
        timeout: seconds for each answer: `response_timeout`.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.

    Source: modbus_new_rtu.
    """

    _is_serial: ClassVar = True
    _after: ClassVar = OPEN

    def __init__(
        self,
        device: str,
        baudrate: int = 19200,
        parity: Parity = "E",
        data_bits: int = 8,
        stop_bits: int = 1,
        *,
        unit: int = 1,
        timeout: float = 1.0,
    ) -> None:
        port = self._port = SerialPort(
            device, baudrate=baudrate, parity=parity, data_bits=data_bits, stop_bits=stop_bits
        )
        self._callback: Any = None
        self._rts_error: BaseException | None = None
        super().__init__(port.context, unit, timeout)

    @property
    def _endpoint(self) -> str:
        return f"rtu://{self._port}"

    # --- settings of the line -------------------------------------------------------------------

    @property
    def serial_mode(self) -> Literal["rs232", "rs485"]:
        """The driver's mode (modbus_rtu_set_serial_mode); the port must be open."""
        number = check(lib.modbus_rtu_get_serial_mode(self._modbus))
        return "rs485" if number == lib.MODBUS_RTU_RS485 else "rs232"

    @serial_mode.setter
    def serial_mode(self, mode: Literal["rs232", "rs485"]) -> None:
        number = _of(MODES, "serial_mode", mode)
        self._set(lib.modbus_rtu_set_serial_mode, number)

    @property
    def rts(self) -> RtsMode:
        """
        The level of RTS while sending, for a transceiver (modbus_rtu_set_rts); "none" at first.

        The port must be open. Errors of a port without RTS are ignored.
        """
        number = check(lib.modbus_rtu_get_rts(self._modbus))
        return next(mode for mode in RTS if RTS[mode] == number)

    @rts.setter
    def rts(self, mode: RtsMode) -> None:
        self._set(lib.modbus_rtu_set_rts, _of(RTS, "rts", mode))

    @property
    def rts_delay(self) -> float:
        """Seconds between RTS and the data (modbus_rtu_set_rts_delay); a character at first."""
        return float(lib.modbus_rtu_get_rts_delay(self._modbus) / 1_000_000)

    @rts_delay.setter
    def rts_delay(self, value: float) -> None:
        number = round(seconds("rts_delay", value, 0, 1) * 1_000_000)
        with self._lock:
            check(lib.modbus_rtu_set_rts_delay(self._modbus, number))

    def set_custom_rts(self, function: Callable[[bool], object]) -> None:
        """
        Call a function in place of setting RTS (modbus_rtu_set_custom_rts).

        Args:
            function: called with True before a frame is sent, and with False behind it, in the
                thread of the call. What it raises is the cause of the ModbusConnectionError that
                the call raises. `rts` must be "up" or "down".
        """
        checked_callback("function", function)

        def turn(_: object, is_on: int) -> None:
            try:
                finished("function", function(bool(is_on)))
            except BaseException as error:  # which C code cannot pass on
                self._rts_error = self._rts_error or error

        callback = ffi.callback("void(modbus_t *, int)", turn)
        self._set(lib.modbus_rtu_set_custom_rts, callback)
        self._callback = callback  # kept alive

    def _set(self, function: Callable[[Any, Any], int], value: Any) -> None:
        with self._lock, self._errors(), self._rts_errors():
            self._ensure_open()
            check(function(self._modbus, value))

    @contextlib.contextmanager
    def _rts_errors(self) -> Iterator[None]:
        """Raise the error of the function for RTS, which makes the results of a call worthless."""
        self._rts_error = None
        try:
            yield
        finally:
            error, self._rts_error = self._rts_error, None
            if error is not None:
                self._spoil()
                self._drop()
                if not isinstance(error, Exception):
                    raise error
                reason = f"the function of set_custom_rts failed: {error!r}"
                raise ModbusConnectionError(reason, errno=errno.EIO) from error

    def _transact(self, request: Request[Any], action: Callable[[], Any]) -> Any:
        if self._callback is None:
            return super()._transact(request, action)
        with self._lock, self._errors(request), self._rts_errors():
            return super()._transact(request, action)

    def _read(self, kind: Any, function: Any, cells: Any, address: int, count: int) -> list[int]:
        if self._callback is None:
            return super()._read(kind, function, cells, address, count)
        with self._lock, self._errors(), self._rts_errors():
            return super()._read(kind, function, cells, address, count)

    def _answer(self, request: bytes, function: Callable[..., int], *arguments: Any) -> int:
        with self._lock, self._errors(), self._rts_errors():
            return super()._answer(request, function, *arguments)

    # --- the port ---------------------------------------------------------------------------------

    def _open(self) -> None:
        self._port.open()
        if error := too_many_descriptors(self._port.descriptor):
            self._port.close()
            raise error

    def _drop(self) -> None:
        self._state = CLOSED
        self._framer = None
        self._port.close()

    def _abandon(self) -> None:
        self._port.abandon()

    def _prepare(self, request: Request[Any] | None = None) -> None:
        if self.unit == 0 and not (request is not None and request.may_be_broadcast):
            raise ValueError("unit 0 is a broadcast, which no unit answers: only writes can be one")
        super()._prepare()
        if (failure := _failures.get(self._port.device)) is not None:
            self._wait_for_silence(failure)
            _failures.pop(self._port.device, None)
        self._discard_input()

    def _wait_for_silence(self, start: float) -> None:
        timeout = self.response_timeout
        silent_at = start + timeout
        limit = time.monotonic() + NOISE * timeout
        while self._wait(self.socket, READ, silent_at):
            self._read_bytes()
            silent_at = time.monotonic() + timeout
            if silent_at > limit:
                raise ModbusTimeoutError("the line is never silent, so that nothing can be sent")

    def _spoil(self) -> None:
        _failures[self._port.device] = time.monotonic()
        if self._state is not CLOSED:
            self._state = OPEN
            self._discard_input()

    # --- frames -----------------------------------------------------------------------------------

    def _read_bytes(self) -> bytes:
        return b"".join(self._port.receive())

    def _discard_input(self) -> int:
        self._port.discard_input()  # modbus_flush would discard unsent bytes, too
        return 0

    def _client_framer(self, request: Request[Any]) -> RtuFramer:
        return RtuFramer("client", self._pause, request if has_own_length(request) else None)

    def _server_framer(self) -> RtuFramer:
        framer = RtuFramer("server", self._pause)
        framer.is_ours = lambda unit: unit == self.unit
        return framer

    @property
    def _pause(self) -> float:
        return self._port.silence.seconds


def _of(names: Mapping[Any, int], name: str, value: object) -> int:
    if not isinstance(value, str) or value not in names:
        raise ValueError(f"{name} must be one of {', '.join(names)}, not {value!r}")
    return names[value]
