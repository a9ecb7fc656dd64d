"""
Unix sockets: Modbus/TCP between programs of one machine, guarded by the permissions of a file.
"""

from __future__ import annotations

import contextlib
import errno
import os
import socket
import stat
import sys
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING, Any, Self

from ..system import lock_file, peer_credentials
from .hosts import BACKLOG
from .sockets import StreamPort
from .waiting import Steps

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions

# The bytes of a path in struct sockaddr_un, without the final 0.
MAX_PATH = 107 if sys.platform == "linux" else 103

# Tries to lock the folder, a hundredth of a second apart: another program holds it while it makes
# its own socket, which takes less than a millisecond.
TRIES = 100


def _checked(path: str) -> str:
    if not 1 <= len(os.fsencode(path)) <= MAX_PATH or "\0" in path:
        raise ValueError(f"path must have 1..{MAX_PATH} bytes, not {path!r}")
    return path


class UnixPort(StreamPort):
    """A connection to a Unix socket."""

    @classmethod
    def of(cls, endpoint: Endpoint, _settings: ConnectionOptions) -> Self:
        return cls(endpoint.path)

    def __init__(self, path: str) -> None:
        super().__init__(_checked(path))

    def _addresses(self, deadline: float) -> Steps[list[Any]]:
        yield from ()
        return [(socket.AF_UNIX, socket.SOCK_STREAM, 0, "", str(self))]


class UnixListener:
    """Listens at the path of a Unix socket, where its owner and its group may connect."""

    def __init__(self, path: str) -> None:
        self._path = _checked(path)
        self._identity: tuple[int, int, int] | None = None

    async def open(self) -> socket.socket:
        """Return a socket that listens; other tasks of the loop run while its folder is locked."""
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.setblocking(False)
            # Linux makes the file with the mode of the socket. Its owner may connect at once: else
            # a server that is killed before it lets others in would seem to be there for ever.
            with contextlib.suppress(OSError):
                os.fchmod(listener.fileno(), 0o600)
            async with _locked(os.path.dirname(self._path) or "."):
                if os.path.lexists(self._path):
                    self._remove_stale()
                listener.bind(self._path)
                self._identity = _identity(self._path)
                listener.listen(BACKLOG)
                os.chmod(self._path, 0o660)  # connecting needs the permission to write
        except BaseException:
            self.close()
            listener.close()
            raise
        return listener

    def _remove_stale(self) -> None:
        if not stat.S_ISSOCK(os.lstat(self._path).st_mode):
            raise OSError(errno.EEXIST, "there is a file that is no socket")
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            number = probe.connect_ex(self._path)
        if number != errno.ECONNREFUSED:
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE))
        os.unlink(self._path)

    def name(self, client: socket.socket) -> tuple[str, str]:
        """Return the path with the user of a client; and the same with its process."""
        try:
            process, user = peer_credentials(client)
        except OSError:  # it has gone already
            return self._path, self._path
        host = f"{self._path} uid {user}"
        return host, f"{host} pid {process}"

    def close(self) -> None:
        """Remove the file, unless another one has taken its place."""
        identity, self._identity = self._identity, None
        if identity is not None:
            with contextlib.suppress(OSError):
                if _identity(self._path) == identity:
                    os.unlink(self._path)


def _identity(path: str) -> tuple[int, int, int]:
    """Return what differs from a later file at the path, whose inode may be the same."""
    status = os.lstat(path)
    return status.st_dev, status.st_ino, status.st_mtime_ns


@contextlib.asynccontextmanager
async def _locked(folder: str) -> AsyncIterator[None]:
    """Lock a folder, so that of two programs that find a stale socket there only one removes it."""
    from asyncio import sleep  # which blocking clients do not import

    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        for _ in range(TRIES):
            try:
                lock_file(descriptor)
                break
            except BlockingIOError:
                await sleep(0.01)
        else:
            raise OSError(errno.EBUSY, f"{folder} is locked by another program")
        yield
    finally:
        os.close(descriptor)
