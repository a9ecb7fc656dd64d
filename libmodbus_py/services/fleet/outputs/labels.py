"""
The labels of the devices of readings, in the form that an output needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Generic, TypeVar

from ..config import DeviceConfig

__all__ = ["Labels"]

Form = TypeVar("Form")


class Labels(Generic[Form]):
    """
    Keeps the labels of each device. Those of a device that was removed are kept until the next
    change, because its last readings may wait.

    Args:
        form: returns what is kept, for the name of a device and its labels.

    Attributes:
        by_device: what is kept, by the name of the device.
    """

    def __init__(self, form: Callable[[str, Mapping[str, str]], Form]) -> None:
        self._form = form
        self._now: dict[str, Form] = {}
        self.by_device: dict[str, Form] = {}

    def set(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Take the labels of all devices."""
        before = self._now
        self._now = {name: self._form(name, each.labels) for name, each in devices.items()}
        self.by_device = {**before, **self._now}
