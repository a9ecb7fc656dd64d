"""
Requests that change a device, for an audit trail: the values before and after.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Mapping as MappingABC
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from ..protocol.errors import IllegalFunction, ServerDeviceFailure
from ..protocol.pdu import (
    MaskWriteRegister,
    Request,
    decode_request,
)
from .access import ACCESSES, Access
from .caller import Auditor, Caller, Executed, ValueChange
from .mapping import Mapping
from .record_file import RecordFile

__all__ = ["answer_audited", "changes_of", "values_at"]


def answer_audited(
    pdu: bytes,
    caller: Caller,
    auditor: Auditor,
    mapping: Mapping,
    files: MappingABC[int, RecordFile],
    respond: Callable[[], bytes],
    *,
    has_rules: bool,
) -> bytes:
    """
    Execute a request, and tell an auditor if it changes the device or is not allowed.

    Args:
        respond: executes the request and returns the response PDU.
        has_rules: True if exception 1 may mean that the client has no right.
    """
    try:
        request = decode_request(pdu)
    except Exception:
        request = None
    changes = request is not None and request.changes
    with mapping.lock:
        found = changes_of(request, caller, mapping, files) if changes else ()
        if changes and not auditor.may_change():
            response = bytes([pdu[0] | 0x80, ServerDeviceFailure.code])
        else:
            response = respond()
    is_refused = has_rules and response[1:] == bytes([IllegalFunction.code])
    if changes or is_refused:
        auditor.note(Executed(caller, pdu, response, found, changes))
    return response


def changes_of(
    request: Request[Any] | None,
    caller: Caller,
    mapping: Mapping | None = None,
    files: MappingABC[int, RecordFile] = MappingProxyType({}),
) -> tuple[ValueChange, ...]:
    """
    Return the values that a request writes, and those before.

    Args:
        mapping, files: those of the device; None for another machine's, whose values are not known.
    """
    kind = ACCESSES.get(type(request))  # type: ignore[arg-type]
    if kind is None:
        return ()
    who = (caller.unit, caller.peer, caller.role)
    if mapping is not None:
        writes = kind.find(request, mapping, who).writes
        return tuple(ValueChange(each, values_at(each, mapping, files)) for each in writes)
    writes = kind.find(request, Mapping(), who).writes
    if isinstance(request, MaskWriteRegister):  # its result depends on the value before
        writes = tuple(replace(each, values=()) for each in writes)
    return tuple(ValueChange(each, None) for each in writes)


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
