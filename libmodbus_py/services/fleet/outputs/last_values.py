"""
The last reading of each point, for whoever asks: metrics do.
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
        statistics: where they are.
    """

    name = "metrics"

    def __init__(self) -> None:
        self.statistics: KeptReadings = KeptReadings()

    def label(self, labels: Mapping[str, Mapping[str, str]]) -> None:
        """Set the labels of devices; others keep theirs."""
        self.statistics.labels = {**self.statistics.labels, **labels}

    async def open(self) -> None:
        """There is nothing to open."""

    async def write(self, readings: Sequence[Reading]) -> None:
        for each in readings:
            self.statistics.by_name[each.device, each.name] = each

    async def close(self) -> None:
        """There is nothing to close."""
