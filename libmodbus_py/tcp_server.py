"""
A TCP endpoint of a server: it listens, and hands over who connects.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
from collections.abc import Callable
from dataclasses import replace

from .chunk_session import ChunkSession, Singles
from .clients import Clients
from .errors import ModbusConnectionError
from .listening import addresses, reason
from .session import FramerSession, Session
from .units import SerialUnits, TcpUnits, Units
from .url import Endpoint

__all__ = ["TcpServer"]

logger = logging.getLogger(__name__)

# As many as the system lets wait; and how many of them become clients in a turn
# of the loop, for the others want theirs.
BACKLOG = 4096
ACCEPTED_AT_ONCE = 16

# How long nobody is accepted when the process has no descriptors left.
RETRY_AFTER = 0.1


class TcpServer:
    """
    Listens on all addresses of a host.

    Raises:
        ModbusConnectionError: it cannot, with errno.
    """

    def __init__(self, endpoint: Endpoint, units: Units, clients: Clients) -> None:
        self._clients = clients
        self._loop = asyncio.get_running_loop()
        self._make_session = _maker(endpoint.framing, units, clients)
        self._listeners: list[socket.socket] = []
        self._retries: dict[socket.socket, asyncio.TimerHandle] = {}
        self._is_short = False  # of descriptors or memory
        self._endpoint = endpoint

    async def open(self) -> Endpoint:
        """Give the endpoint with the port it got."""
        port = self._endpoint.port
        found = await addresses(self._endpoint, socket.SOCK_STREAM)
        try:
            for family, host in found:
                listener = socket.create_server(
                    (host, port), family=family, backlog=BACKLOG, reuse_port=False
                )
                listener.setblocking(False)
                self._listeners.append(listener)
                if not port:  # a free one is free on one address; on the next it may be taken
                    port = listener.getsockname()[1]
                    break
        except OSError as error:
            self.close()
            raise ModbusConnectionError(
                f"cannot listen on {self._endpoint}: {reason(error)}", errno=error.errno
            ) from error
        for listener in self._listeners:
            self._loop.add_reader(listener.fileno(), self._accept, listener)
        return replace(self._endpoint, port=port)

    def close(self) -> None:
        for retry in self._retries.values():
            retry.cancel()
        for listener in self._listeners:
            self._loop.remove_reader(listener.fileno())
            listener.close()
        self._listeners.clear()

    def _accept(self, listener: socket.socket) -> None:
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                client, address = listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(listener, error)
                return
            self._is_short = False
            client.setblocking(False)
            self._clients.admit(client, address, self._make_session)

    def _pause(self, listener: socket.socket, error: OSError) -> None:
        """No descriptors, no memory: what waits to be accepted would wake the loop for ever."""
        if error.errno not in (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM):
            raise error
        if not self._is_short:
            logger.warning("%s: cannot accept: %s", self._endpoint, reason(error))
        self._is_short = True
        self._loop.remove_reader(listener.fileno())
        self._retries[listener] = self._loop.call_later(RETRY_AFTER, self._resume, listener)

    def _resume(self, listener: socket.socket) -> None:
        del self._retries[listener]
        self._loop.add_reader(listener.fileno(), self._accept, listener)


def _maker(
    framing: str, units: Units, clients: Clients
) -> Callable[[str, Callable[[bytes], None], Callable[[], None]], Session]:
    statistics = clients.statistics
    if framing != "tcp":
        line = SerialUnits(units)
        return lambda peer, *way: FramerSession(line, framing, peer, statistics, *way)
    own = TcpUnits(units)
    if units.faults:
        return lambda peer, *way: FramerSession(own, framing, peer, statistics, *way)
    singles = Singles(own, statistics, clients.later)
    return lambda peer, write, _: ChunkSession(own, peer, statistics, singles, write)
