"""
The channel of a server's session, without a connection.
"""

from __future__ import annotations

from collections.abc import Callable

from libmodbus_py.ports.trace import Trace
from libmodbus_py.security.describing import CertificateHolder

__all__ = ["FakeChannel"]


class FakeChannel:
    """Calls the functions that it is given; see `libmodbus_py.server.service.Channel`."""

    def __init__(
        self,
        write: Callable[[bytes], object] = lambda data: None,
        follow: Callable[[], object] = lambda: None,
        trace: Trace | None = None,
    ) -> None:
        self.address = "peer"
        self.role: str | None = None
        self.holder: CertificateHolder | None = None
        self.trace = trace
        self.write = write
        self.follow = follow

    def hang_up(self) -> bool:
        return False
