"""
A context of Python's ssl that the application has made.
"""

from __future__ import annotations

import ssl

from .acceptance import Acceptance
from .tunnel import Tunnel, expiry, name_of

__all__ = ["GivenContext"]


class GivenContext:
    """
    A client's context used as it is, for programs that must use an existing one.

    The checks of a server are those of the context, which may be none at all. Prefer `Security`,
    which makes the checks that Modbus Security requires.

    Args:
        context: a context for clients; it may serve any number of connections.

    Attributes:
        own: empty, because a context does not tell which certificate it shows.

    Raises:
        TypeError: the argument is not an SSLContext.
        ValueError: the context is for servers.
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
        Return the client's end of a tunnel.

        Args:
            host: the host of the server, which is the name that its certificate must have.
            session: the session of an earlier tunnel to it, to resume.
        """
        return Tunnel(self._context, server_name=name_of(host), session=session)

    def refusal(self, tunnel: Tunnel) -> str | None:
        """Return why a certificate is refused after a good handshake; None if it is not."""
        return expiry(tunnel)

    def acceptance(self) -> Acceptance:
        """Return what checks later whether the certificate of a new connection is still good."""
        return Acceptance(lambda: None)

    def warn_of_end(self) -> None:
        """Do nothing, because a context does not tell which certificate it shows."""
