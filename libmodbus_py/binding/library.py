"""The only import of the compiled module, and the only reading of its errno."""

from __future__ import annotations

import errno
from typing import Any

from ..protocol.errors import (
    ExceptionResponse,
    FrameError,
    InvalidResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)
from ..protocol.scan import NOT_BUILT

try:
    from ._libmodbus import ffi, lib
except ImportError as error:
    if "libmodbus.so" in str(error):
        raise ImportError(
            f"libmodbus_py needs the C library libmodbus: apt install libmodbus5 ({error})"
        ) from error
    raise ImportError(f"{NOT_BUILT} ({error})") from error

__all__ = ["check", "ffi", "lib", "loaded_version", "make"]


_LIBRARY_ERRORS: dict[int, type[ModbusError]] = {
    lib.EMBBADCRC: FrameError,
    lib.EMBBADDATA: InvalidResponse,
    lib.EMBBADEXC: InvalidResponse,
    lib.EMBUNKEXC: InvalidResponse,
    lib.EMBMDATA: InvalidResponse,
    lib.EMBBADSLAVE: InvalidResponse,
    errno.ETIMEDOUT: ModbusTimeoutError,
}


def check(result: int) -> int:
    """
    Return the result of a C call, or raise the error for -1.

    cffi keeps errno per thread, as it was right after the call. It is set to 0 here, because
    libmodbus never clears it, and some of its failures do not set it.

    Raises:
        ModbusError: the call failed; the subclass for its errno, else a ModbusConnectionError.
    """
    if result != -1:
        return result
    number, ffi.errno = ffi.errno, 0
    if lib.MODBUS_ENOBASE <= number <= lib.EMBXGTAR:
        raise ExceptionResponse.of(number - lib.MODBUS_ENOBASE)
    text = ffi.string(lib.modbus_strerror(number)).decode() if number else "libmodbus gave no error"
    kind = _LIBRARY_ERRORS.get(number)
    if kind is not None:
        raise kind(text)
    raise ModbusConnectionError(text, errno=number) from OSError(number, text)


def make(context: Any) -> Any:
    """
    Return a new modbus_t, which is freed when it is no longer referenced.

    Raises:
        ModbusError: it is NULL; as for `check`.
    """
    if context == ffi.NULL:
        check(-1)
    return ffi.gc(context, lib.modbus_free)


def loaded_version() -> tuple[int, int, int]:
    """Return the version of the loaded libmodbus, which need not be that of its header."""
    return (
        lib.libmodbus_version_major,
        lib.libmodbus_version_minor,
        lib.libmodbus_version_micro,
    )
