"""
What messages are about: the subjects of readings and commands. A client of MQTT finds them as
topics, with / in place of each point.

::

    modbus.readings.DEVICE              what was read of it
    modbus.write.DEVICE.POINT           a value to write; the outcome is the answer
    modbus.written.DEVICE.POINT         the outcome again, for who can have no answer
"""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

__all__ = ["READINGS", "WRITE", "asked_about", "readings_of", "written"]

READINGS = "modbus.readings"
WRITE = "modbus.write"
WRITTEN = "modbus.written"

# What has a meaning in subjects or topics, or must not be there.
_SPECIAL = re.compile(r"[\s.*>%/+#$\0]")


def readings_of(device: str) -> str:
    """Where the readings of a device go."""
    return f"{READINGS}.{_token(device)}"


def asked_about(subject: str) -> tuple[str, str]:
    """The device and the point that something is to be written to."""
    device, _, point = subject.removeprefix(f"{WRITE}.").partition(".")
    return unquote(device), unquote(point)


def written(device: str, point: str) -> str:
    """Where the outcome goes."""
    return f"{WRITTEN}.{_token(device)}.{_token(point)}"


def _token(name: str) -> str:
    return _SPECIAL.sub(lambda found: quote(found[0], safe=""), name).replace(".", "%2E")
