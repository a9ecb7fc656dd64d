"""
The port of a client, by the transport of its endpoint.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions
    from .port import Port
    from .schemes import Transport

__all__ = ["make_port", "port_class"]


def port_class(transport: Transport) -> Any:
    """Return the class of the ports of a transport."""
    # Each is imported where it is needed: ssl alone takes longer than the rest of a client.
    match transport:
        case "tcp":
            from .sockets import TcpPort

            return TcpPort
        case "udp":
            from .sockets import UdpPort

            return UdpPort
        case "tls":
            from .tls import TlsPort

            return TlsPort
        case "unix":
            from .unix import UnixPort

            return UnixPort
        case "serial":
            from .serial import SerialPort

            return SerialPort


def make_port(endpoint: Endpoint, settings: ConnectionOptions) -> Port:
    """Return the port of a client, closed; raise TypeError or ValueError for a wrong setting."""
    if settings["security"] is not None and not endpoint.is_secure:
        raise ValueError(f"security is for tls:// only, not for {endpoint.scheme}://")
    port: Port = port_class(endpoint.transport).of(endpoint, settings)
    return port
