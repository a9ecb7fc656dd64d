"""
The subjects of messages with readings and commands. For an MQTT client of the NATS server they
are topics, with / in place of each dot.

::

    modbus.readings.DEVICE              the readings of a device
    modbus.write.DEVICE.POINT           a value to write; the reply contains the outcome
    modbus.written.DEVICE.POINT         the outcome, for clients that cannot receive replies
"""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

__all__ = ["READINGS", "WRITE", "asked_about", "readings_of", "written"]

READINGS = "modbus.readings"
WRITE = "modbus.write"
WRITTEN = "modbus.written"

# Characters that have a meaning in subjects or topics, or are not allowed there.
_SPECIAL = re.compile(r"[\s.*>%/+#$\0]")


def readings_of(device: str) -> str:
    """Return the subject of the readings of a device."""
    return f"{READINGS}.{_token(device)}"


def asked_about(subject: str) -> tuple[str, str]:
    """Return the device and the point of the subject of a write."""
    device, _, point = subject.removeprefix(f"{WRITE}.").partition(".")
    return unquote(device), unquote(point)


def written(device: str, point: str) -> str:
    """Return the subject of the outcomes of writes to a point."""
    return f"{WRITTEN}.{_token(device)}.{_token(point)}"


def _token(name: str) -> str:
    return _SPECIAL.sub(lambda found: quote(found[0], safe=""), name).replace(".", "%2E")
