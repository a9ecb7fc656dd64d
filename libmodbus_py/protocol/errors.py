"""
The exceptions, grouped by cause.

::

    ValueError, TypeError            an argument is wrong; nothing was sent
    ModbusError                      the base of those below: unit, function, sent, received, ...
      ExceptionResponse              the server refused the request: .code
        IllegalFunction 1   IllegalDataAddress 2   IllegalDataValue 3   ServerDeviceFailure 4
        Acknowledge 5   ServerDeviceBusy 6   NegativeAcknowledge 7   MemoryParityError 8
        GatewayPathUnavailable 10   GatewayTargetFailedToRespond 11
      FrameError                     bytes that are not a frame
      InvalidResponse                a frame that is not a valid response to the request
      ModbusTimeoutError             no response in time; also a TimeoutError
      ModbusConnectionError          no connection; also a ConnectionError
      NoValue                        the registers that were read hold no value; also a ValueError

A server refuses a request by raising the same `ExceptionResponse` classes.
"""

from __future__ import annotations

import copy
from typing import Any, ClassVar, TypedDict, TypeVar, Unpack

# fmt: off
__all__ = [
    "Acknowledge", "ExceptionResponse", "FrameError", "GatewayPathUnavailable",
    "GatewayTargetFailedToRespond", "IllegalDataAddress", "IllegalDataValue", "IllegalFunction",
    "InvalidResponse", "MemoryParityError", "ModbusConnectionError", "ModbusError",
    "ModbusTimeoutError", "NegativeAcknowledge", "ServerDeviceBusy", "ServerDeviceFailure",
]
# fmt: on


class _Transaction(TypedDict, total=False):
    unit: int | None
    function: int | None
    asked: str
    endpoint: str
    sent: bytes
    received: bytes


MAX_RECEIVED = 600
"""The most received bytes that an error keeps: more than the longest frame of any line has."""

_SYSTEM_ATTRIBUTES = ("errno", "strerror", "filename", "filename2")
"""The attributes of OSError."""


def in_hex(data: bytes, most: int = 32) -> str:
    """Return the first bytes in hexadecimal, and their number if these are not all."""
    text = data[:most].hex(" ")
    return text if len(data) <= most else f"{text} ... ({len(data)} bytes)"


class ModbusError(Exception):
    """
    The base of all errors that occur after the arguments were checked.

    Attributes:
        unit: the unit of the request, 0..255, or None.
        function: the function code of the request, 1..127, or None.
        asked: the request in words, or empty.
        endpoint: the URL of the connection, such as "tcp://192.0.2.10:502", or empty.
        sent: the frame of the request, with header and check bytes, or empty.
        received: the first 600 bytes that were received until the error occurred, or empty.
        names: the items of a plan, such as points of a map, that the request was for; empty if it
            was for other items, too.
        answers_another: True if the received frame answers another request: its unit, function or
            transaction id is different.

    ``str()`` returns one line for messages; ``repr()`` returns all of the above.
    """

    answers_another: bool = False
    names: tuple[Any, ...] = ()
    unit: int | None = None
    function: int | None = None
    asked: str = ""
    endpoint: str = ""
    sent: bytes = b""
    _received: bytes = b""

    def __init__(self, reason: str = "", **transaction: Unpack[_Transaction]) -> None:
        if not isinstance(reason, str):
            raise TypeError(f"reason must be a string, not {type(reason).__name__}")
        super().__init__(reason)
        for name, value in transaction.items():
            if name not in _Transaction.__annotations__:
                text = f"{type(self).__name__}() has no argument {name!r}"
                raise TypeError(f"{text}; it has {', '.join(_Transaction.__annotations__)}")
            setattr(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        # OSError keeps these outside of __dict__, and would lose them in a copy. None is left out:
        # it is printed where it was set.
        state = {name: getattr(self, name, None) for name in _SYSTEM_ATTRIBUTES}
        known = {name: value for name, value in state.items() if value is not None}
        return type(self), self.args, {**vars(self), **known}

    def __setstate__(self, state: dict[str, Any] | None) -> None:
        # As CPython does. PyPy would put errno into __dict__, where nothing reads it.
        for name, value in (state or {}).items():
            setattr(self, name, value)

    @property
    def received(self) -> bytes:
        return self._received

    @received.setter
    def received(self, data: bytes) -> None:
        # The first ones: headers are there, and what all that follows was mistaken for.
        self._received = bytes(data[:MAX_RECEIVED])

    def __str__(self) -> str:
        where = [
            "" if self.unit is None else f"unit {self.unit}",
            "" if self.function is None else f"function {self.function}",
            self.asked,
            ", ".join(map(str, self.names)),
        ]
        prefix = ", ".join(part for part in where if part)
        reason = super().__str__()
        return f"{prefix}: {reason}" if prefix else reason

    def __repr__(self) -> str:
        names = ("code", "errno", "unit", "function", "asked", "endpoint", "sent", "received")
        parts = [repr(super().__str__())]
        for name in names:
            if (value := getattr(self, name, None)) not in (None, "", b""):
                parts.append(f"{name}={_shown(value)}")
        return f"{type(self).__name__}({', '.join(parts)})"


def _shown(value: object) -> str:
    return f"<{in_hex(value)}>" if isinstance(value, bytes) else repr(value)


class ExceptionResponse(ModbusError):
    """
    The server refused the request with an exception code, 1..255 (application protocol, section 7).

    Clients raise the subclass for the code; this class if there is none. A hook or handler of a
    server raises one to refuse a request.

    Attributes:
        code: the exception code.
    """

    code: int = 0
    meaning: ClassVar[str] = "unknown exception"

    def __init__(
        self, reason: str = "", *, code: int | None = None, **transaction: Unpack[_Transaction]
    ) -> None:
        if isinstance(reason, int):
            hint = f"code {reason} is ExceptionResponse.of({reason})"
            raise TypeError(f"reason must be a string; {hint}")
        if code is not None:
            self.code = code
        default = f"{self.meaning} (exception {self.code})"
        super().__init__(default if reason == "" else reason, **transaction)

    def __init_subclass__(cls, code: int | None = None, meaning: str = "") -> None:
        super().__init_subclass__()
        if code is not None:
            cls.code, cls.meaning = code, meaning

    @staticmethod
    def of(code: int, **transaction: Unpack[_Transaction]) -> ExceptionResponse:
        """Return the exception for a code, 0..255, of the subclass for that code."""
        return _BY_CODE.get(code, ExceptionResponse)(code=code, **transaction)


class IllegalFunction(ExceptionResponse, code=1, meaning="illegal function"):
    """Exception 1: the function is not supported, or not in the current state of the server."""


class IllegalDataAddress(ExceptionResponse, code=2, meaning="illegal data address"):
    """Exception 2: some of the addresses do not exist."""


class IllegalDataValue(ExceptionResponse, code=3, meaning="illegal data value"):
    """Exception 3: a quantity, length or constant of the request is wrong."""


class ServerDeviceFailure(ExceptionResponse, code=4, meaning="server device failure"):
    """Exception 4: the server failed while it executed the request."""


class Acknowledge(ExceptionResponse, code=5, meaning="acknowledge"):
    """Exception 5: the server has accepted the request, but will need a long time for it."""


class ServerDeviceBusy(ExceptionResponse, code=6, meaning="server device busy"):
    """Exception 6: the server is busy with a long command; the client should retry later."""


class NegativeAcknowledge(ExceptionResponse, code=7, meaning="negative acknowledge"):
    """Exception 7: the program function cannot be performed (PI-MBUS-300)."""


class MemoryParityError(ExceptionResponse, code=8, meaning="memory parity error"):
    """Exception 8: the file memory failed a consistency check."""


class GatewayPathUnavailable(ExceptionResponse, code=10, meaning="gateway path unavailable"):
    """Exception 10: the gateway has no path to the unit."""


class GatewayTargetFailedToRespond(
    ExceptionResponse, code=11, meaning="gateway target device failed to respond"
):
    """Exception 11: the unit behind the gateway did not respond."""


NO_UNIT = (GatewayPathUnavailable, GatewayTargetFailedToRespond)
"""The exceptions of a gateway in place of a unit that it cannot reach (application protocol, 7)."""

_BY_CODE: dict[int, type[ExceptionResponse]] = {
    kind.code: kind for kind in ExceptionResponse.__subclasses__()
}


class FrameError(ModbusError):
    """
    The received bytes are not a frame: a CRC, LRC or header is wrong, or they are not hexadecimal.

    Attributes:
        overrun: True if there were more bytes than a frame can have.
    """

    overrun = False


class InvalidResponse(ModbusError):
    """The received frame does not answer the request: a wrong unit, function, length or echo."""


class ModbusTimeoutError(ModbusError, TimeoutError):
    """No complete response arrived within the timeout."""


class ModbusConnectionError(ModbusError, ConnectionError):
    """
    The connection could not be established, or was lost.

    Attributes:
        errno: the system's error number, or None; for a host name that cannot be
            resolved, the negative error number of getaddrinfo. The OSError itself, if any,
            is ``__cause__``.
    """

    def __init__(
        self, reason: str = "", *, errno: int | None = None, **transaction: Unpack[_Transaction]
    ) -> None:
        super().__init__(reason, **transaction)
        self.errno = errno


Error = TypeVar("Error", bound=ModbusError)


def alike(error: Error) -> Error:
    """Return a copy of an error that concerns several requests: each request completes its own."""
    twin = copy.copy(error)
    twin.__cause__ = error.__cause__
    twin.__suppress_context__ = error.__suppress_context__  # which the line above sets
    return twin
