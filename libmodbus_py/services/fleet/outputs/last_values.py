"""
The last reading of each point, for metrics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..config import DeviceConfig
from ..readings import Reading

__all__ = ["KeptReadings", "LastValues"]


@dataclass(slots=True, weakref_slot=True)
class KeptReadings:
    """
    The last readings.

    Attributes:
        by_name: (device, name) -> its last reading.
        labels: device -> its labels.
    """

    by_name: dict[tuple[str, str], Reading] = field(default_factory=dict)
    labels: Mapping[str, Mapping[str, str]] = field(default_factory=dict)


class LastValues:
    """
    Keeps the last reading of each point of a fleet.

    Attributes:
        statistics: the last readings.
        is_live: True, because readings of earlier runs are not wanted.
    """

    name = "metrics"
    is_live = True

    def __init__(self) -> None:
        self.statistics: KeptReadings = KeptReadings()

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Set the labels of devices, and forget the readings of all other devices."""
        kept = self.statistics
        kept.labels = {name: each.labels for name, each in devices.items()}
        kept.by_name = {key: each for key, each in kept.by_name.items() if key[0] in devices}

    async def open(self) -> None:
        """Do nothing: there is no connection."""

    async def write(self, readings: Sequence[Reading]) -> None:
        kept = self.statistics
        for each in readings:
            # A reading may have waited while its device was removed.
            if each.quality == "offline" or each.device not in kept.labels:
                kept.by_name.pop((each.device, each.name), None)
            else:
                kept.by_name[each.device, each.name] = each

    async def close(self) -> None:
        """Do nothing: there is no connection."""
