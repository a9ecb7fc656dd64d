"""The base of both contexts: the modbus_t, its lock and state, its errors and settings."""

from __future__ import annotations

import contextlib
import enum
import errno
import os
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, ClassVar, Literal, Self, TypeVar

from ..binding.library import check, ffi, lib
from ..ports.port import abandoned_in_children, lost
from ..ports.waiting import READ, WaitInterrupted, Waker
from ..protocol import errors
from ..protocol.checks import integer, seconds
from ..protocol.frames import Frame, Framer
from ..protocol.mistakes import explain_reference
from ..protocol.pdu.request import Request

Result = TypeVar("Result")

FD_SETSIZE = 1024
"""Descriptors from here on abort the process in select() (libmodbus 3.1.6)."""

RECOVERY: dict[str, int] = {
    "none": lib.MODBUS_ERROR_RECOVERY_NONE,
    "protocol": lib.MODBUS_ERROR_RECOVERY_PROTOCOL,
}


class ContextState(enum.Enum):
    """The states of a context."""

    CLOSED = enum.auto()
    OPEN = enum.auto()  # something has to be done before the next request
    READY = enum.auto()
    BUSY = enum.auto()  # in a call
    FOREIGN = enum.auto()  # in a forked child


CLOSED, OPEN, READY, BUSY, FOREIGN = ContextState


class ContextBase(ABC):
    """The base of both contexts: one modbus_t, and one call of it at a time."""

    _is_serial: ClassVar[bool]
    _after: ClassVar[ContextState]  # the state after a request that was answered

    _state: ContextState = CLOSED
    _modbus: Any = None
    _waker: Waker | None = None

    def __init__(self, modbus: Any, unit: int, timeout: float) -> None:
        self._lock = threading.RLock()
        self._state = CLOSED
        self._is_closed = False
        self._modbus = modbus
        self._registers: Any = ffi.new("uint16_t[]", lib.MODBUS_MAX_READ_REGISTERS)
        self._bits: Any = ffi.new("uint8_t[]", lib.MODBUS_MAX_READ_BITS)
        self._error_recovery: Literal["none", "protocol"] = "none"
        self._debug = False
        self.unit = unit
        self.response_timeout = timeout
        # Otherwise each byte of an answer might take as long as the answer.
        self.byte_timeout = 0.0
        abandoned_in_children(self)

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self._endpoint}, unit {self.unit}>"

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __del__(self) -> None:
        if self._modbus is not None:
            self._release()

    # --- connections ----------------------------------------------------------------------

    def connect(self) -> None:
        """
        Connect, or open the port, within `response_timeout`; do nothing if it is open already.

        Raises:
            ModbusConnectionError: it cannot be opened; with errno.
            RuntimeError: in a forked child.
        """
        with self._lock:
            self._is_closed = False
            with self._errors():
                self._ensure_open()

    def close(self) -> None:
        """
        Close the connection or port (modbus_close); `connect` opens it again.

        May be called repeatedly, from any thread: a call that waits ends with a
        ModbusConnectionError on TCP, and is waited for on a serial line.
        """
        self._is_closed = True
        self._interrupt()
        with self._lock:
            self._release()

    def abandon(self) -> None:
        """Close the descriptors in a forked child, without an effect on its parent."""
        self._lock = threading.RLock()
        self._state = FOREIGN
        if self._waker is not None:
            self._waker.renew()
        self._close_waker()
        self._abandon()

    def _ensure_open(self) -> None:
        state = self._state
        if state is BUSY:
            raise RuntimeError("a signal handler has used the context during a call of this thread")
        if state is FOREIGN:
            raise RuntimeError("a context does not survive a fork: make one in the child")
        if self._is_closed:
            raise errors.ModbusConnectionError(
                "closed; connect() opens it again", errno=errno.EBADF
            )
        if state is CLOSED:
            self._open()
            self._state = self._after

    def _prepare(self, request: Request[Any] | None = None) -> None:
        """Prepare the context for a request; None for one that reads registers or bits."""
        self._ensure_open()

    def _wait(self, descriptor: int, events: int, deadline: float) -> bool:
        """Wait for a descriptor until a time; raise an error if `close` ends the wait."""
        try:
            return self._get_waker().wait(descriptor, events, deadline)
        except WaitInterrupted:
            raise closed_meanwhile() from None

    def _get_waker(self) -> Waker:
        if self._waker is None:
            try:
                self._waker = Waker()
            except OSError as error:  # the process has no free descriptor
                raise lost(error) from error
        if self._is_closed:  # `close` sets this, and then wakes
            raise closed_meanwhile()
        return self._waker

    def _close_waker(self) -> None:
        waker, self._waker = self._waker, None
        if waker is not None:
            waker.close()

    def _interrupt(self) -> None:
        if (waker := self._waker) is not None:
            waker.wake()

    def _release(self) -> None:
        if self._state is not FOREIGN:
            self._drop()
        self._close_waker()

    @property
    @abstractmethod
    def _endpoint(self) -> str: ...

    @abstractmethod
    def _open(self) -> None:
        """Open the connection or port, or raise ModbusConnectionError."""

    @abstractmethod
    def _drop(self) -> None:
        """Close the connection or port, if it is open."""

    @abstractmethod
    def _abandon(self) -> None:
        """As `_drop`, in a forked child."""

    @abstractmethod
    def _read_bytes(self) -> bytes:
        """Return received bytes, or raise ModbusConnectionError."""

    @abstractmethod
    def _spoil(self) -> None:
        """Make sure that no late answer is used, because a request has failed."""

    # --- requests ---------------------------------------------------------------------------

    def _transact(self, request: Request[Any], action: Callable[[], Result]) -> Result:
        """Return the result of an action that sends a request and receives its answer."""
        with self._lock, self._errors(request):
            self._prepare(request)
            self._state = BUSY
            try:
                result = action()
                self._state = self._after
                return result
            except errors.ModbusError as error:
                self._judge(error)
                raise
            finally:
                if self._state is BUSY:
                    self._spoil()

    def _judge(self, error: errors.ModbusError) -> None:
        """Decide what becomes of the connection after an error of a request."""
        if isinstance(error, errors.ExceptionResponse):
            self._state = self._after
        elif isinstance(error, errors.ModbusConnectionError):
            self._spoil()
            self._drop()

    @contextlib.contextmanager
    def _errors(self, request: Request[Any] | None = None) -> Any:
        """Add the request, the unit and the endpoint to errors."""
        try:
            yield
        except errors.ModbusError as error:
            self._describe(error, request)
            raise

    def _describe(self, error: errors.ModbusError, request: Request[Any] | None) -> None:
        error.unit, error.endpoint = self.unit, self._endpoint
        if request is not None:
            error.function, error.asked = request.function, str(request)
            hint = explain_reference(getattr(request, "address", None), request.function)
            if hint and isinstance(error, errors.IllegalDataAddress):
                error.args = (f"{error.args[0]}; {hint}",)

    def _receive_frames(self, framer: Framer, deadline: float) -> list[Frame | errors.FrameError]:
        """
        Return the next frames and errors, one or more.

        Raises:
            ModbusTimeoutError: there are none until the deadline (time.monotonic).
            ModbusConnectionError: the connection has ended, or was closed.
        """
        descriptor = self.socket
        waker = self._get_waker()
        while True:
            until = deadline
            if framer.pending and framer.quiet is not None:
                until = min(deadline, waker.now() + framer.quiet)
            if self._wait(descriptor, READ, until):
                frames = framer.scan(self._read_bytes())
            else:
                frames = framer.scan_silence()
            if frames:
                return frames
            if waker.now() >= deadline:
                raise errors.ModbusTimeoutError(os.strerror(errno.ETIMEDOUT))

    # --- settings ------------------------------------------------------------------------------

    @property
    def unit(self) -> int:
        """
        The unit of requests and of a slave (modbus_set_slave): 0..247; on TCP also 255.

        With `enable_quirks` (MODBUS_QUIRK_MAX_SLAVE) up to 255. On a serial line, 0 is a broadcast.
        """
        unit: int = lib.modbus_get_slave(self._modbus)
        return unit

    @unit.setter
    def unit(self, unit: int) -> None:
        number = integer("unit", unit, 0, 255)
        with self._lock:
            if lib.modbus_set_slave(self._modbus, number) == -1:
                others = "" if self._is_serial else " or 255"
                raise ValueError(f"unit must be in 0..247{others}, not {number}")

    @property
    def response_timeout(self) -> float:
        """Seconds until the whole answer is there (modbus_set_response_timeout)."""
        return self._seconds(lib.modbus_get_response_timeout)

    @response_timeout.setter
    def response_timeout(self, value: float) -> None:
        number = seconds("response_timeout", value, 0.000001)
        self._set_seconds(lib.modbus_set_response_timeout, number)

    @property
    def byte_timeout(self) -> float:
        """
        Seconds between two pieces of an answer (modbus_set_byte_timeout); 0, as it is at first,
        for no such limit. Else an answer may take longer than `response_timeout`.
        """
        return self._seconds(lib.modbus_get_byte_timeout)

    @byte_timeout.setter
    def byte_timeout(self, value: float) -> None:
        self._set_seconds(lib.modbus_set_byte_timeout, seconds("byte_timeout", value, 0))

    @property
    def indication_timeout(self) -> float:
        """Seconds that `receive` waits (modbus_set_indication_timeout); 0, at first: for ever."""
        return self._seconds(lib.modbus_get_indication_timeout)

    @indication_timeout.setter
    def indication_timeout(self, value: float) -> None:
        number = seconds("indication_timeout", value, 0)
        self._set_seconds(lib.modbus_set_indication_timeout, number)

    @property
    def error_recovery(self) -> Literal["none", "protocol"]:
        """
        The recovery of libmodbus after a wrong answer (modbus_set_error_recovery).

        "none" at first, because a context is closed or silent after a failure; "protocol" sleeps
        for one `response_timeout` and flushes. MODBUS_ERROR_RECOVERY_LINK is refused: while the
        other side is away its calls never return, and Ctrl-C does not end them.
        """
        return self._error_recovery

    @error_recovery.setter
    def error_recovery(self, mode: Literal["none", "protocol"]) -> None:
        if mode not in RECOVERY:
            raise ValueError(f'error_recovery must be "none" or "protocol", not {mode!r}')
        with self._lock:
            check(lib.modbus_set_error_recovery(self._modbus, RECOVERY[mode]))
            self._error_recovery = mode

    @property
    def debug(self) -> bool:
        """True to print frames and errors to the C library's stdout and stderr."""
        return self._debug

    @debug.setter
    def debug(self, is_on: bool) -> None:
        if not isinstance(is_on, bool):
            raise TypeError(f"debug must be True or False, not {is_on!r}")
        with self._lock:
            check(lib.modbus_set_debug(self._modbus, is_on))
            self._debug = is_on

    @property
    def modbus(self) -> Any:
        """The modbus_t itself, for `libmodbus_py.low_level`; valid as long as the context."""
        return self._modbus

    @property
    def socket(self) -> int:
        """The descriptor of the connection or port (modbus_get_socket); -1 while it is closed."""
        descriptor: int = lib.modbus_get_socket(self._modbus)
        return descriptor

    @property
    def header_length(self) -> int:
        """Bytes before the function code: 7 on TCP, 1 on RTU (modbus_get_header_length)."""
        length: int = lib.modbus_get_header_length(self._modbus)
        return length

    def enable_quirks(self, mask: int) -> None:
        """
        Enable quirks, such as ``low_level.lib.MODBUS_QUIRK_MAX_SLAVE`` (modbus_enable_quirks).

        Raises:
            NotImplementedError: the loaded library is older than 3.1.9.
        """
        self._quirks(lib.modbus_enable_quirks, mask)

    def disable_quirks(self, mask: int) -> None:
        """Disable quirks (modbus_disable_quirks); raises as `enable_quirks` does."""
        self._quirks(lib.modbus_disable_quirks, mask)

    def _quirks(self, function: Callable[[Any, int], int], mask: int) -> None:
        number = integer("mask", mask, 0, lib.MODBUS_QUIRK_ALL)
        with self._lock:
            if function(self._modbus, number) == 0:
                return
            if ffi.errno == errno.ENOSYS:
                raise NotImplementedError("quirks need libmodbus 3.1.9 or newer")
            check(-1)

    def _seconds(self, function: Callable[[Any, Any, Any], int]) -> float:
        parts = ffi.new("uint32_t[2]")
        check(function(self._modbus, parts, parts + 1))
        return float(parts[0] + parts[1] / 1_000_000)

    def _set_seconds(self, function: Callable[[Any, int, int], int], value: float) -> None:
        microseconds = max(1, round(value * 1_000_000)) if value else 0
        with self._lock:
            check(function(self._modbus, *divmod(microseconds, 1_000_000)))


def closed_meanwhile() -> errors.ModbusConnectionError:
    return errors.ModbusConnectionError("closed by another thread", errno=errno.EBADF)


def too_many_descriptors(descriptor: int) -> errors.ModbusConnectionError | None:
    """Return the error for a descriptor that libmodbus cannot wait for; None if it can."""
    if descriptor < FD_SETSIZE:
        return None
    text = f"descriptor {descriptor}: libmodbus takes those below {FD_SETSIZE}; Client takes all"
    return errors.ModbusConnectionError(text, errno=errno.EMFILE)
