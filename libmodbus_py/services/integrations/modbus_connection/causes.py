"""
The errors of modbus-connection, made from those of this package.
"""

from __future__ import annotations

import errno
from typing import TypeAlias

import modbus_connection as theirs

from ....protocol.errors import (
    ExceptionResponse,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)

__all__ = ["not_connected", "told"]

# asyncio and clients raise RuntimeError if another event loop uses them.
Cause: TypeAlias = ModbusError | theirs.ModbusError | RuntimeError

KINDS: tuple[tuple[type[BaseException], type[theirs.ModbusError]], ...] = (
    (ModbusTimeoutError, theirs.ModbusTimeoutError),
    (ModbusConnectionError, theirs.ModbusConnectionError),
    (ModbusError, theirs.ModbusProtocolError),
    (RuntimeError, theirs.ModbusConnectionError),
)


def told(error: Cause, operation: str) -> theirs.ModbusError:
    """Return the error of modbus-connection for an operation; the message names the operation."""
    text = f"{operation}: {_reason(error)}"
    if isinstance(error, theirs.ModbusError):  # perhaps one that several operations waited for
        return type(error)(text)
    if isinstance(error, ExceptionResponse):
        return theirs.ModbusExceptionError.from_code(error.code, text)
    return _kind(error)(text)


def not_connected(error: ModbusConnectionError | RuntimeError) -> theirs.ModbusError:
    """Return the error of modbus-connection for a connection that could not be established."""
    is_late = getattr(error, "errno", None) == errno.ETIMEDOUT
    kind = theirs.ModbusTimeoutError if is_late else theirs.ModbusConnectionError
    return kind(_reason(error))


def _kind(error: ModbusError | RuntimeError) -> type[theirs.ModbusError]:
    if getattr(error, "answers_another", False):
        return theirs.ModbusDesyncError
    return next(kind for ours, kind in KINDS if isinstance(error, ours))


def _reason(error: Cause) -> str:
    """Return the message of an error without its request, because the operation names that."""
    if isinstance(error, ModbusError):
        place = "" if error.unit is None or not error.asked else f"unit {error.unit}: "
        return f"{place}{error.args[0]}"
    return str(error)
