"""
A context of Python's ssl that somebody else has made.
"""

from __future__ import annotations

import ssl

from .tunnel import Tunnel, expiry, name_of

__all__ = ["GivenContext"]


class GivenContext:
    """
    A client's context as it is, for programs that get one from elsewhere and must use it.

    What it demands of a server, who made it has decided: it may be nothing at all. Whoever
    may choose takes `Security`, which asks for what Modbus Security does.

    Args:
        context: a client's; it may serve any number of connections.

    Attributes:
        own: nothing: no context says which certificate it shows.

    Raises:
        TypeError: no SSLContext.
        ValueError: a server's.
    """

    own: bytes = b""

    def __init__(self, context: ssl.SSLContext) -> None:
        if not isinstance(context, ssl.SSLContext):
            raise TypeError(f"context must be an SSLContext, not {type(context).__name__}")
        if context.protocol == ssl.PROTOCOL_TLS_SERVER:
            raise ValueError("context must be a client's, not a server's")
        self._context = context

    def to_server(self, host: str, session: ssl.SSLSession | None = None) -> Tunnel:
        """
        Make the client's end.

        Args:
            host: where it leads, which is the name that the server's certificate must have.
            session: of an earlier tunnel there, to resume.
        """
        return Tunnel(self._context, server_name=name_of(host), session=session)

    def refusal(self, tunnel: Tunnel) -> str | None:
        """Return why a certificate is refused after a good handshake; None if it is not."""
        return expiry(tunnel)
