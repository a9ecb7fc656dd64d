"""
What our errors are called in modbus-connection.
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

__all__ = ["Cause", "not_connected", "told"]

# RuntimeError: another event loop, which asyncio and our client refuse.
Cause: TypeAlias = ModbusError | theirs.ModbusError | RuntimeError

KINDS: tuple[tuple[type[BaseException], type[theirs.ModbusError]], ...] = (
    (ModbusTimeoutError, theirs.ModbusTimeoutError),
    (ModbusConnectionError, theirs.ModbusConnectionError),
    (ModbusError, theirs.ModbusProtocolError),
    (RuntimeError, theirs.ModbusConnectionError),
)


def told(error: Cause, operation: str) -> theirs.ModbusError:
    """Make the error of an operation, which its message names."""
    text = f"{operation}: {_reason(error)}"
    if isinstance(error, theirs.ModbusError):  # of connecting, which several may have met
        return type(error)(text)
    if isinstance(error, ExceptionResponse):
        return theirs.ModbusExceptionError.from_code(error.code, text)
    return _kind(error)(text)


def not_connected(error: ModbusConnectionError | RuntimeError) -> theirs.ModbusError:
    """Make the error of a connection that does not come about."""
    is_late = getattr(error, "errno", None) == errno.ETIMEDOUT
    kind = theirs.ModbusTimeoutError if is_late else theirs.ModbusConnectionError
    return kind(_reason(error))


def _kind(error: ModbusError | RuntimeError) -> type[theirs.ModbusError]:
    if getattr(error, "answers_another", False):
        return theirs.ModbusDesyncError
    return next(kind for ours, kind in KINDS if isinstance(error, ours))


def _reason(error: Cause) -> str:
    """What happened; what was asked, the operation says."""
    if isinstance(error, ModbusError):
        place = "" if error.unit is None or not error.asked else f"unit {error.unit}: "
        return f"{place}{error.args[0]}"
    return str(error)
