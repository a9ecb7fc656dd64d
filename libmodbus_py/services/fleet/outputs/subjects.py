"""
The subjects of messages with readings and commands. For an MQTT client of the NATS server they
are topics, with / in place of each dot.

::

    modbus.readings.DEVICE              the readings of a device
    modbus.write.DEVICE.POINT           a value to write; the reply contains the outcome
    modbus.written.DEVICE.POINT         the outcome, for clients that cannot receive replies
"""

from __future__ import annotations

from ..levels import Levels

__all__ = ["READINGS", "WRITE", "asked_about", "readings_of", "written"]

READINGS = "modbus.readings"
WRITE = "modbus.write"
WRITTEN = "modbus.written"

# Characters that have a meaning in subjects or topics, or are not allowed there.
_LEVELS = Levels(r"[\s.*>%/+#$\0]")


def readings_of(device: str) -> str:
    """Return the subject of the readings of a device."""
    return f"{READINGS}.{_LEVELS.spell(device)}"


def asked_about(subject: str) -> tuple[str, str] | None:
    """Return the device and the point of the subject of a write; None unless both are names."""
    device, _, point = subject.removeprefix(f"{WRITE}.").partition(".")
    names = _LEVELS.read(device), _LEVELS.read(point)
    return None if names[0] is None or names[1] is None else (names[0], names[1])


def written(device: str, point: str) -> str:
    """Return the subject of the outcomes of writes to a point."""
    return f"{WRITTEN}.{_LEVELS.spell(device)}.{_LEVELS.spell(point)}"
