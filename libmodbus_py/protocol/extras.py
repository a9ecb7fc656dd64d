"""
The optional dependencies, and how each is added to this installation.
"""

from __future__ import annotations

import re
import sys
from typing import NamedTuple


class Extra(NamedTuple):
    """
    The packages that a feature needs.

    Attributes:
        requirement: the requirement as pip takes it.
        package: the package of Debian; empty if Debian has none.
    """

    requirement: str
    package: str


EXTRAS: dict[str, Extra] = {
    "security": Extra("cryptography>=38", "python3-cryptography"),
    "metrics": Extra("prometheus_client>=0.16", "python3-prometheus-client"),
    "homeassistant": Extra("modbus-connection>=4.12,<5", ""),
    "mqtt": Extra("aiomqtt>=2.3", "python3-asyncio-mqtt"),  # Debian 12 has an older one
    "influx": Extra("httpx>=0.23", "python3-httpx"),
    "gpio": Extra("gpiod>=2", "python3-libgpiod"),  # Debian 12 has an older one
    "completion": Extra("argcomplete>=3.3", "python3-argcomplete"),
    "pytest": Extra("pytest>=7", "python3-pytest"),
    "nats": Extra("nats-py>=2.16", ""),
    "sunspec": Extra("pysunspec2>=1.3", ""),
    "spreadsheets": Extra("openpyxl>=3.0", "python3-openpyxl"),
}
"""Extra of pyproject.toml -> the package that it needs."""


def what_is_missing(feature: str, extra: str) -> str:
    """
    Return the message for a feature whose extra is not installed.

    Args:
        feature: the subject of the message, such as "MQTT".
    """
    name = re.split("[<>=]", EXTRAS[extra].requirement, maxsplit=1)[0]
    return f"{feature} needs {name}: {how_to_add(extra)}"


def how_to_add(extra: str) -> str:
    """
    Return the command that adds what an extra needs to the Python that runs this package.

    The name of this package is on no index, and pip must not change the Python of Debian: there the
    command installs Debian's package, or makes a virtual environment that has this package, too.
    """
    requirement, package = EXTRAS[extra]
    if "/dist-packages/" not in __file__:
        return f"{sys.executable} -m pip install '{requirement}'"
    if package:
        return f"sudo apt install {package}"
    return f"python3 -m venv --system-site-packages VENV && VENV/bin/pip install '{requirement}'"
