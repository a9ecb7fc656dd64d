"""
The origin of a request, and who records what became of it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from ..security.describing import CertificateHolder
from .access import Access
from .event_log import EventLog

__all__ = ["Auditor", "Caller", "Executed", "ValueChange"]


class Caller(NamedTuple):
    """
    The origin of a request.

    Attributes:
        unit: the unit that was addressed, 0..255.
        peer: the client: "host:port", or the serial port.
        log: the event log of the line on which the request came; None for the device's own.
        is_broadcast: True if no response is sent.
        role: the role in the client's certificate; None without a role, or without TLS.
        on_unauthorized: called for each request that `authorize` does not allow; None for nothing.
        holder: the holder of the client's certificate; None without TLS.
        auditor: records each change, and each request that `authorize` does not allow; None for
            no audit.
    """

    unit: int = 0
    peer: str = ""
    log: EventLog | None = None
    is_broadcast: bool = False
    role: str | None = None
    on_unauthorized: Callable[[], object] | None = None
    holder: CertificateHolder | None = None
    auditor: Auditor | None = None


class ValueChange(NamedTuple):
    """
    A range of items that a request writes.

    Attributes:
        access: the table, the addresses and the new values.
        before: the previous values; None if they are not known.
    """

    access: Access
    before: tuple[Any, ...] | None


class Executed(NamedTuple):
    """
    A request with its outcome.

    Attributes:
        caller: its origin.
        request: the request PDU.
        response: the response PDU; empty if there is none.
        changes: what it writes, or would have written.
        is_change: False for a request that only reads, and was refused.
    """

    caller: Caller
    request: bytes
    response: bytes
    changes: tuple[ValueChange, ...]
    is_change: bool


class Auditor(Protocol):
    """Records who changed what."""

    def may_change(self) -> bool:
        """Return False if changes must be refused, because none can be recorded."""
        ...

    def note(self, executed: Executed) -> None:
        """Record a request. Never raises."""
