"""The port of a client, by the transport of its endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions
    from .port import Port
    from .schemes import Transport


def port_class(transport: Transport) -> Any:
    """
    Return the class of the ports of a transport.

    Each is imported when it is first needed: ssl alone, which TLS needs, takes longer than the rest
    of a client, and a serial port needs libmodbus.
    """
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
        case "listen":
            from .listening import ListeningPort

            return ListeningPort


def make_port(endpoint: Endpoint, settings: ConnectionOptions) -> Port:
    """
    Return the port of a client, closed.

    Args:
        endpoint: the endpoint to connect to, with the options of its URL.
        settings: the checked options of the client; a port reads `keepalive` and `security`.

    Raises:
        TypeError, ValueError: a setting of the endpoint is wrong, or not for its transport.
    """
    if settings["security"] is not None and not endpoint.is_secure:
        raise ValueError(f"security is for tls:// only, not for {endpoint.scheme}://")
    if settings["source"] is not None and (endpoint.has_path or endpoint.is_listening):
        raise ValueError(f"source is for hosts, not for {endpoint.scheme}://")
    if settings["greeting"] is not None and not endpoint.is_listening:
        raise ValueError(f"greeting is for listen+tcp://, not for {endpoint.scheme}://")
    port: Port = port_class(endpoint.transport).of(endpoint, settings)
    return port
