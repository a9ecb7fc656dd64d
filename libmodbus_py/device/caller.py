"""
The origin of a request, and the audit of requests that change a device.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping as MappingABC
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from ..protocol.pdu import MaskWriteRegister, Request
from .access import Access, touched
from .event_log import EventLog
from .mapping import Mapping
from .records import RecordFile

if TYPE_CHECKING:
    from ..security.describing import CertificateHolder

__all__ = ["Auditor", "Caller", "Executed", "ValueChange", "changes_of", "values_at"]


class Caller(NamedTuple):
    """
    The origin of a request.

    Attributes:
        unit: the unit that was addressed, 0..255.
        peer: the client: "host:port", or the serial port.
        log: the event log of the line on which the request came; None for the device's own.
        is_broadcast: True if no response is sent.
        role: the role in the client's certificate; None without a role, or without TLS.
        on_unauthorized: called for each request that `authorize` does not allow, with True if it
            said so, False if it raised an exception; None for nothing.
        holder: the holder of the client's certificate; None without TLS.
        auditor: records each change, and each request that `authorize` does not allow; None for
            no audit.
    """

    unit: int = 0
    peer: str = ""
    log: EventLog | None = None
    is_broadcast: bool = False
    role: str | None = None
    on_unauthorized: Callable[[bool], object] | None = None
    holder: CertificateHolder | None = None
    auditor: Auditor | None = None

    @property
    def who(self) -> tuple[int, str, str | None]:
        """Unit, peer and role of an `Access`."""
        return self.unit, self.peer, self.role

    def telling(self, note: Callable[[bool], object]) -> Caller:
        """Return a caller for which another function is called first, as `on_unauthorized` is."""
        before = self.on_unauthorized

        def both(is_said: bool) -> None:
            note(is_said)
            if before is not None:
                before(is_said)

        return self._replace(on_unauthorized=both)


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
    """A request with its outcome: a change, or one that was refused."""

    caller: Caller
    request: bytes
    response: bytes  # empty if there is none
    changes: tuple[ValueChange, ...]  # what it writes, or would have written
    is_change: bool


class Auditor(Protocol):
    """Records who changed what."""

    def may_change(self) -> bool:
        """Return False if changes must be refused, because none can be recorded."""
        ...

    def note(self, executed: Executed) -> None:
        """Record a request. Never raises."""


def changes_of(
    request: Request[Any] | None,
    caller: Caller,
    mapping: Mapping | None = None,
    files: MappingABC[int, RecordFile] = MappingProxyType({}),
) -> tuple[ValueChange, ...]:
    """Return the values that a request writes, and those before, if the device is here."""
    writes = touched(request, caller.who, mapping).writes
    if mapping is not None:
        return tuple(ValueChange(write, values_at(write, mapping, files)) for write in writes)
    if isinstance(request, MaskWriteRegister):  # its result depends on the value before
        writes = tuple(replace(write, values=()) for write in writes)
    return tuple(ValueChange(write, None) for write in writes)


def values_at(
    access: Access, mapping: Mapping, files: MappingABC[int, RecordFile]
) -> tuple[Any, ...] | None:
    """Return the present values; None if an address does not exist."""
    first, count = access.address, access.count
    if access.table == "file":
        file = files.get(access.file)
        return tuple(file.read(first, count)) if file and file.has(first, count) else None
    table = getattr(mapping, access.table)
    return tuple(table[first : first + count]) if table.has(first, count) else None
