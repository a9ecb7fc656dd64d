"""
Finds the worker that polls a device, and the one that answers commands to devices that no worker
polls.
"""

from __future__ import annotations

import json
from collections.abc import Iterator

from .records import Connection
from .worker import Worker

__all__ = ["Locations"]


class Locations:
    """
    Finds devices in the bucket.

    Args:
        worker: its view of the bucket is searched.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        # The connection of each device, as of this revision.
        self._places: dict[str, Connection] = {}
        self._as_of = -1

    def refusal(self, device: str, now: float) -> str:
        """
        Return the reason to refuse a command to a device that this worker does not poll; "" if
        another worker answers the command.

        The worker with the lowest id refuses commands to devices that no worker polls.
        """
        worker = self._worker
        living = {each.id for each in worker.view.members.values() if worker.is_heard(each, now)}
        me = worker.lease.id
        if min(living, default="") != me:
            return ""
        connection = self._connection_of(device)
        if connection is None:
            return f"there is no device {device!r}"
        holder = worker.view.holder(connection.slot)
        if holder is not None and holder.id in living - {me}:
            return ""
        return f"no worker polls {device!r} now"

    def _connection_of(self, device: str) -> Connection | None:
        view = self._worker.view
        if self._as_of != view.last_touched:
            self._as_of = view.last_touched
            self._places = {
                name: connection
                for connection in view.connections
                for name in _names(connection.devices)
            }
        return self._places.get(device)


def _names(devices: str) -> Iterator[str]:
    """Yield the names of devices in JSON, which any program may have written to the bucket."""
    found = json.loads(devices)
    listed = found.get("devices") if isinstance(found, dict) else None
    for each in listed if isinstance(listed, list) else ():
        name = each.get("name") if isinstance(each, dict) else None
        if isinstance(name, str):
            yield name
