"""
The steps of procedures of the clients: one request or several.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any, NamedTuple, TypeVar

from ..protocol import pdu
from ..protocol.errors import ModbusError

__all__ = ["ChangeRegister", "Several", "Steps"]

Result = TypeVar("Result")


class Several(NamedTuple):
    """
    Requests that a procedure makes together, as `execute_many` takes them.

    Attributes:
        stops: True to send nothing more after a ModbusError, and to return the results and that
            error; only without `return_exceptions`.
    """

    requests: Iterable[pdu.Request[Any]]
    max_in_flight: int
    return_exceptions: bool
    stops: bool = False

    @property
    def returned(self) -> tuple[type[BaseException], ...]:
        """The exceptions that are returned among the results."""
        return (ModbusError,) if self.return_exceptions or self.stops else ()


class ChangeRegister(NamedTuple):
    """
    A holding register that is read, changed and written, because the device lacks function 22.

    No other such step on the connection takes place at the same time.
    """

    request: pdu.MaskWriteRegister

    def write(self, register: int) -> pdu.WriteRegister:
        """Return the request that writes the register, as in section 6.16 of the specification."""
        request = self.request
        value = register & request.and_mask | request.or_mask & ~request.and_mask
        return pdu.WriteRegister(request.address, value & 0xFFFF)


Steps = Generator[pdu.Request[Any] | Several | ChangeRegister, Any, Result]
