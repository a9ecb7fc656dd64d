"""
The port of a client, made for its endpoint.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Protocol

from .endpoint import Endpoint
from .port import Port
from .schemes import TRANSPORTS

if TYPE_CHECKING:
    from ..security.given import GivenContext
    from ..security.security import Security

__all__ = ["PortSettings", "make_port"]


class PortSettings(Protocol):
    """
    The options of a client that concern its port.

    Attributes:
        keepalive: seconds of silence after which TCP probes the connection; None for never.
        security: the certificates, for TLS.
    """

    @property
    def keepalive(self) -> float | None: ...
    @property
    def security(self) -> Security | GivenContext | None: ...


def make_port(endpoint: Endpoint, settings: PortSettings) -> Port:
    """
    Return the port of a client, closed.

    Raises:
        TypeError, ValueError: a setting that this transport cannot have, or of the wrong range.
    """
    rules = TRANSPORTS[endpoint.transport]
    if settings.security is not None and not rules.is_secure:
        raise ValueError(f"security is for tls:// only, not for {endpoint.scheme}://")
    module, _, name = rules.port_class.partition(".")
    made: Port = getattr(import_module(f".{module}", __package__), name).of(endpoint, settings)
    return made
