"""
The places of a scan: an endpoint with each setting that its line may have.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from ...client.blocking import Context
from ...ports.endpoint import Endpoint
from ...ports.schemes import SERIAL_DEFAULTS, parity_of
from ...protocol.checks import integer, seconds
from ...security.security import Security

# fmt: off
__all__ = [
    "BAUDRATES", "FIRST_UNITS", "ON_LINES", "ON_NETWORKS", "PARITIES", "USUAL",
    "USUAL_UNITS", "Place", "listed", "places",
]
# fmt: on

# In the order in which they are tried: those that most devices leave the factory with come first.
BAUDRATES = (9600, 19200, 38400, 57600, 115200, 4800, 2400, 1200)

PARITIES = ("E", "N", "O")

# Tried before all other rates and parities. The specification's default is 19200 8E1 (serial
# line, 3.4).
USUAL = ((9600, "E"), (9600, "N"), (19200, "E"), (19200, "N"))

# Where a line has several settings, the first units are asked at all of them, then the usual
# ones, then all others: nearly every device leaves the factory as one of the first.
FIRST_UNITS = (1, 2, 3, 247)
USUAL_UNITS = (*range(1, 11), 17, 100, 247)

# Serial line, 2.5.1: no parity means two stop bits. A receiver looks at the first one only, so
# this finds devices with one stop bit as well.
_STOP_BITS = {"E": 1, "N": 2, "O": 1}

# Default timeouts in seconds. After a request to another unit, a server made with libmodbus takes
# what comes within 0.5 s for that unit's response: a shorter timeout finds only every second such
# server, if any. On a network there may be a gateway, which waits for its own devices.
ON_LINES, ON_NETWORKS = 0.6, 1.0

# Bits of the longest character (serial line, 2.5.1), and characters per byte.
CHARACTER = 11
CHARACTERS = {"rtu": 1, "ascii": 2}

# Many timeouts only mean that units are absent; a new connection would lose late responses.
NEVER_DEAD = 1_000_000

Item = TypeVar("Item")


@dataclass(frozen=True)
class Place:
    """An endpoint with one setting; `timeout` is without the time on the line, in seconds."""

    endpoint: Endpoint
    timeout: float
    security: Security | None = None

    @property
    def is_serial(self) -> bool:
        return self.endpoint.is_serial

    @property
    def has_broadcast(self) -> bool:
        return self.endpoint.framing in ("rtu", "ascii")

    @property
    def has_ids(self) -> bool:
        """True if transaction ids identify responses."""
        return self.endpoint.framing in ("tcp", "udp")

    @property
    def settings(self) -> dict[str, Any]:
        """Baud rate, parity, data bits and stop bits; empty on networks."""
        if not self.is_serial:
            return {}
        settings = {**SERIAL_DEFAULTS, **self.endpoint.serial_settings}
        return {name: settings[name] for name in SERIAL_DEFAULTS}

    def __str__(self) -> str:
        if not self.is_serial:
            return str(self.endpoint)
        return "{baudrate} {data_bits}{parity}{stop_bits}".format(**self.settings)

    def url(self, unit: int) -> str:
        """Return the URL of a client of a unit, with these settings."""
        others = {**self.endpoint.client_options, "unit": unit}
        return replace(self.endpoint, client_options=others).url

    def wait(self, size: int) -> float:
        """Return the timeout in seconds for a request and a response of this size together."""
        if not self.is_serial:
            return self.timeout
        characters = size * CHARACTERS[self.endpoint.framing]
        return self.timeout + characters * CHARACTER / float(self.settings["baudrate"])

    def context(self, **options: Any) -> Context:
        """
        Make a client that repeats no request and sends none by itself.

        Raises:
            TypeError, ValueError: the URL or an option is wrong.
        """
        options |= {"retries": 0, "busy_retries": 0, "max_pause": 0}
        options["timeouts_before_reconnect"] = NEVER_DEAD
        if self.has_ids:
            # Even where all responses come from unit 255.
            options["accept_unit"] = "any"
        if self.security is not None:
            options["security"] = self.security
        return Context(self.endpoint, options)


def places(
    endpoint: Endpoint,
    baudrates: Iterable[int] | None,
    parities: Iterable[str] | None,
    timeout: float | None,
    security: Security | None = None,
) -> list[Place]:
    """
    Return the endpoint with each setting; the URL gives the settings that no argument gives.

    Raises:
        TypeError, ValueError: a setting is out of range, or is given for a network.
    """
    if timeout is None:
        usual = ON_LINES if endpoint.is_serial else ON_NETWORKS
        timeout = endpoint.client_options.get("timeout", usual)
    timeout = seconds("timeout", timeout)
    if not endpoint.is_serial:
        for name, given in (("baudrates", baudrates), ("parities", parities)):
            if given is not None:
                raise ValueError(f"{name} are for serial ports, not for {endpoint.scheme}://")
        return [Place(endpoint, timeout, security)]
    options = endpoint.options
    rates = [options["baudrate"]] if "baudrate" in options else BAUDRATES
    kinds = [options["parity"]] if "parity" in options else PARITIES
    settings = [
        (integer("baudrate", rate, 1, 4_000_000), parity)
        for rate in listed("baudrates", baudrates, rates)
        for parity in dict.fromkeys(map(parity_of, listed("parities", parities, kinds)))
    ]
    if baudrates is None and parities is None:
        settings.sort(key=lambda each: USUAL.index(each) if each in USUAL else len(USUAL))
    return [Place(_set(endpoint, *setting), timeout, security) for setting in settings]


def _set(endpoint: Endpoint, baudrate: int, parity: str) -> Endpoint:
    usual = {"stop_bits": _STOP_BITS[parity]}
    return replace(
        endpoint, options={**usual, **endpoint.options, "baudrate": baudrate, "parity": parity}
    )


def listed(name: str, given: Iterable[Item] | None, usual: Iterable[Item]) -> list[Item]:
    """
    Return each value once, in the order given.

    Raises:
        TypeError, ValueError: the argument is not a list, or empty.
    """
    chosen = usual if given is None else given
    if not isinstance(chosen, Iterable):
        raise TypeError(f"{name} must be a list, not {type(given).__name__}")
    found = list(dict.fromkeys(chosen))
    if not found:
        raise ValueError(f"{name} must hold at least one")
    return found
