"""
Steps of the procedures of the clients: requests, one or several.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any, NamedTuple, TypeVar

from ..protocol import pdu
from ..protocol.errors import ModbusError

__all__ = ["Several", "Steps"]

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


Steps = Generator[pdu.Request[Any] | Several, Any, Result]
