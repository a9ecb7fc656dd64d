"""
Wires that record the bytes between a client and a server.

`SerialWire` is a null-modem cable made of two pseudo-terminals; `TcpWire` is a relay in front of a
TCP server. Both are for demonstrations and tests.
"""

from __future__ import annotations

import contextlib
import os
import select
import selectors
import socket
import threading
from typing import Literal, NamedTuple, Self

# Bytes are dropped if the line takes none for this many seconds, as without flow control.
TIMEOUT = 1.0


def open_line() -> tuple[int, int, str]:
    """Return the far end and the near end of a raw line, and the path of the near end."""
    import pty
    import tty

    far, near = pty.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    return far, near, os.ttyname(near)


def read_what_is_there(far: int) -> bytes:
    """Return the bytes that can be read without waiting, possibly none."""
    try:
        return os.read(far, 4096)
    except BlockingIOError:
        return b""


def write_all(far: int, data: bytes) -> None:
    """Write all bytes; drop the rest if there is no room for `TIMEOUT` seconds."""
    while data:
        try:
            data = data[os.write(far, data) :]
        except BlockingIOError:
            if not select.select([], [far], [], TIMEOUT)[1]:
                return


class WireBytes(NamedTuple):
    """Bytes of one sender, as they were read from the wire."""

    sender: Literal["client", "server"]
    data: bytes


class _Wire:
    """Carries bytes both ways in a thread, until closed."""

    def __init__(self) -> None:
        self.passed: list[WireBytes] = []
        self._selector = selectors.DefaultSelector()
        self._wake, self._sleep = socket.socketpair()
        self._selector.register(self._sleep, selectors.EVENT_READ, None)
        self._unplug_end = threading.Event()
        self._thread = threading.Thread(target=self._carry, name="wire", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._wake.close()
        self._thread.join()
        self._sleep.close()
        self._selector.close()
        self._close_ends()

    def clear(self) -> None:
        """Forget the recorded bytes."""
        self.passed.clear()

    def sent_by(self, sender: Literal["client", "server"]) -> bytes:
        """Return all bytes that one side has sent, in one piece."""
        return b"".join(part.data for part in self.passed if part.sender == sender)

    def unplug(self) -> None:
        """Close both ends, as when a cable is pulled; return when this is done."""
        self._wake.send(b"u")
        self._unplug_end.wait()

    def _close_ends(self) -> None:
        raise NotImplementedError

    def _carry(self) -> None:
        while True:
            for key, _ in self._selector.select():
                if key.data is not None:
                    key.data()
                elif self._sleep.recv(1):
                    for entry in [*self._selector.get_map().values()]:
                        if entry.data is not None:
                            self._selector.unregister(entry.fileobj)
                    self._close_ends()
                    self._unplug_end.set()
                    break  # the other descriptors are closed now
                else:
                    return


class SerialWire(_Wire):
    """
    Two serial ports (pseudo-terminals) that are connected with each other in a ``with`` block.

    Attributes:
        client, server: the paths of the ports.
        passed: the recorded bytes, oldest first.

    Raises:
        OSError: the system has no pseudo-terminals left.
    """

    def __init__(self) -> None:
        super().__init__()
        far_of_client, near_of_client, self.client = open_line()
        far_of_server, near_of_server, self.server = open_line()
        # The near ends stay open, so that users can reopen them.
        self._open = [far_of_client, near_of_client, far_of_server, near_of_server]
        self._join(far_of_client, far_of_server, "client")
        self._join(far_of_server, far_of_client, "server")

    def _join(self, source: int, sink: int, sender: Literal["client", "server"]) -> None:
        def carry() -> None:
            if data := read_what_is_there(source):
                self.passed.append(WireBytes(sender, data))
                write_all(sink, data)

        self._selector.register(source, selectors.EVENT_READ, carry)

    def _close_ends(self) -> None:
        while self._open:
            os.close(self._open.pop())


class TcpWire(_Wire):
    """
    A relay in front of a TCP server on this machine, which runs in a ``with`` block.

    Args:
        port: the port of the server on 127.0.0.1.

    Attributes:
        port: the port of the relay on 127.0.0.1, to which clients connect.
        passed: the recorded bytes, oldest first.

    Raises:
        OSError: the relay cannot be opened.
    """

    def __init__(self, port: int) -> None:
        super().__init__()
        self._target = port
        listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = listener.getsockname()[1]
        self._open = [listener]
        self._selector.register(listener, selectors.EVENT_READ, self._accept)

    def _accept(self) -> None:
        client, _ = self._open[0].accept()
        server = socket.create_connection(("127.0.0.1", self._target))
        for end in (client, server):
            end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._open += (client, server)
        self._join(client, server, "client")
        self._join(server, client, "server")

    def _join(
        self, source: socket.socket, sink: socket.socket, sender: Literal["client", "server"]
    ) -> None:
        def carry() -> None:
            try:
                data = source.recv(4096)
            except OSError:
                data = b""
            if data:
                self.passed.append(WireBytes(sender, data))
                sink.sendall(data)
                return
            self._selector.unregister(source)
            with contextlib.suppress(OSError):
                sink.shutdown(socket.SHUT_WR)

        self._selector.register(source, selectors.EVENT_READ, carry)

    def _close_ends(self) -> None:
        for end in self._open:
            end.close()
