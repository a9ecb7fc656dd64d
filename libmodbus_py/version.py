"""
The version; the optional dependencies, and how each is added to this installation.
"""

import sys

__version__ = "0.1.0"

EXTRAS: dict[str, tuple[str, str]] = {
    "security": ("cryptography>=38", "python3-cryptography"),
    "metrics": ("prometheus_client>=0.16", "python3-prometheus-client"),
    "homeassistant": ("modbus-connection>=4.12,<5", ""),
    "mqtt": ("aiomqtt>=2.3", "python3-asyncio-mqtt"),  # Debian 12 has an older one
    "influx": ("httpx>=0.23", "python3-httpx"),
    "gpio": ("gpiod>=2", "python3-libgpiod"),  # Debian 12 has an older one
    "completion": ("argcomplete>=3.3", "python3-argcomplete"),
    "pytest": ("pytest>=7", "python3-pytest"),
    "nats": ("nats-py>=2.16", ""),
    "sunspec": ("pysunspec2>=1.3", ""),
    "spreadsheets": ("openpyxl>=3.0", "python3-openpyxl"),
}
"""Extra of pyproject.toml -> the requirement as pip takes it; Debian's package, if there is one."""


def what_is_missing(feature: str, extra: str) -> str:
    """Return the message for a feature, such as "MQTT", whose extra is not installed."""
    return f"{feature} needs {EXTRAS[extra][0].partition('>')[0]}: {how_to_add(extra)}"


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
