"""
Which devices answer, as their readings show.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..readings import Reading

__all__ = ["DeviceStates"]


class DeviceStates:
    """
    The devices that answer: at least one of their points was read, or refused, the last time.

    Attributes:
        told: device -> True if it answers, as it was published; without removed devices.
    """

    def __init__(self) -> None:
        self.told: dict[str, bool] = {}
        self._answered: dict[str, set[str]] = {}

    def changed(self, readings: Sequence[Reading]) -> dict[str, bool]:
        """Return the devices of readings whose state is to be published; True if they answer."""
        for each in readings:
            points = self._answered.setdefault(each.device, set())
            if each.quality in ("good", "bad"):
                points.add(each.name)
            else:
                points.discard(each.name)
        states = {each.device: bool(self._answered[each.device]) for each in readings}
        return {name: state for name, state in states.items() if self.told.get(name) != state}

    def note(self, published: Mapping[str, bool], readings: Sequence[Reading]) -> None:
        """Note states that were published, and forget devices that are not polled any more."""
        self.told |= published
        for each in readings:
            if each.quality == "offline" and not self._answered.get(each.device):
                self._answered.pop(each.device, None)
                self.told.pop(each.device, None)
