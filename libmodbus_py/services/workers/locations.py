"""
Where a device is that this worker does not have; and whether it answers for it in the name of all.
"""

from __future__ import annotations

import json

from .records import Connection
from .worker import Worker

__all__ = ["Locations"]


class Locations:
    """
    What the bucket says of devices.

    Args:
        worker: what it has seen counts.
    """

    def __init__(self, worker: Worker) -> None:
        self._worker = worker
        # Those of all devices, and the last change that they rest on.
        self._places: dict[str, Connection] = {}
        self._as_of = -1

    def refusal(self, device: str, now: float) -> str:
        """
        Give what to say of a device that is not here; "" if another worker says it.

        One of all workers, the first by its id, speaks for devices that nobody has.
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
        return f"nobody polls {device!r} now"

    def _connection_of(self, device: str) -> Connection | None:
        view = self._worker.view
        if self._as_of != view.last_touched:
            self._as_of = view.last_touched
            self._places = {
                each.get("name"): connection
                for connection in view.connections
                for each in json.loads(connection.devices)["devices"]
            }
        return self._places.get(device)
