"""What may never happen, however late things are: a device that is asked by two."""

from __future__ import annotations

from fuzz.asked_devices import Asked
from tests.support.inexcusable import Inexcusable

__all__ = ["none_doubled"]


def none_doubled(asked: Asked) -> None:
    if asked.doubles:
        raise Inexcusable(f"{asked.doubles} polls by one of two that asked the same device")
