"""
What an audit trail records, parted by whose events they are.
"""

from __future__ import annotations

from libmodbus_py.serve import AuditEvent

__all__ = ["Events"]


class Events(list[AuditEvent]):
    """The events of peers, and in `own` those of the server itself."""

    def __init__(self) -> None:
        self.own: list[AuditEvent] = []

    def append(self, event: AuditEvent) -> None:
        (super() if event.peer else self.own).append(event)
