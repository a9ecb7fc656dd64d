"""
The last reading of each point, for metrics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

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
    """

    name = "metrics"

    def __init__(self) -> None:
        self.statistics: KeptReadings = KeptReadings()

    def label(self, labels: Mapping[str, Mapping[str, str]]) -> None:
        """Set the labels of devices; others keep theirs."""
        self.statistics.labels = {**self.statistics.labels, **labels}

    async def open(self) -> None:
        """Do nothing: there is no connection."""

    async def write(self, readings: Sequence[Reading]) -> None:
        for each in readings:
            self.statistics.by_name[each.device, each.name] = each

    async def close(self) -> None:
        """Do nothing: there is no connection."""
