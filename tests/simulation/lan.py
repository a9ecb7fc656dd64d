"""
A network in memory for tests that are written in one thread: whatever waits lets time pass.

Servers and gateways serve in an event loop that runs only while the test waits for something, so
that the clock stands still between two lines of a test.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import struct
from collections.abc import Awaitable, Callable, Iterator
from types import SimpleNamespace
from typing import Any, Self, TypeVar
from unittest.mock import patch

from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.waiting import WaitInterrupted
from libmodbus_py.server import limits
from libmodbus_py.server.serving import Serving
from libmodbus_py.services.gateway import gateway, routes

from .lines import Party, SerialLine
from .loop import cancel_all, complaints_of
from .network import Network
from .ports import MemoryWaker
from .sockets import MemorySocket

Result = TypeVar("Result")

DESCRIPTORS = 20_000  # what a process of the simulated machine may have open, whatever this one may

PATIENCE = 3600.0  # simulated seconds that a test waits for what is to come


class Lan(Network):
    """
    A network, and the event loop of all that serves there; blocking clients wait in it, too.

    Used as a context manager. Within it ``Server.background`` and ``Gateway.background`` serve in
    that loop.
    """

    def __init__(self, seed: int = 0) -> None:
        super().__init__(seed)
        self.missing: set[str] = set()  # devices that gateways do not find
        self._loop = self.loop()
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        stack = self._stack
        stack.callback(asyncio.set_event_loop, None)
        stack.enter_context(contextlib.closing(self._loop))
        self._complaints = stack.enter_context(complaints_of(self._loop))
        asyncio.set_event_loop(self._loop)
        stack.enter_context(self.installed())
        # An attribute of a class that is a function gets the server that it is called on.
        background = lambda server, *urls: self._serving(server, *urls)  # noqa: E731
        stack.enter_context(patch.object(Serving, "background", background))
        stack.enter_context(patch.object(limits, "most_descriptors", lambda: DESCRIPTORS))
        stack.enter_context(patch.object(gateway, "check_line", routes.check_line))
        stack.enter_context(patch.object(routes, "os", SimpleNamespace(path=self._paths())))
        return self

    def __exit__(self, *raised: Any) -> None:
        with self._stack:
            self.pass_time(0)
            tasks = cancel_all(self._loop)
        if raised[0] is None:
            assert not self._complaints, self._complaints
            assert not tasks, tasks

    @property
    def now(self) -> float:
        return self.events.now

    @property
    def turns(self) -> int:
        """How many turns the loop of the servers has taken."""
        return self._loop.turns

    def call_each_turn(self, call: Callable[[], object]) -> None:
        """Call a function whenever a turn of the loop ends."""
        self._loop.call_each_turn(call)

    # --- waiting --------------------------------------------------------------------------------

    def pass_time(self, seconds: float) -> None:
        """Let so many seconds pass; 0 for no more than what has to happen now."""
        self._loop.run_until(lambda: False, seconds)

    def until(self, is_so: Callable[[], object], seconds: float = PATIENCE) -> bool:
        """Let time pass until a condition holds; return whether it does."""
        return bool(is_so()) or self._loop.run_until(lambda: bool(is_so()), seconds)

    def wait(self, awaited: Awaitable[Result]) -> Result:
        """Run something to its end in the loop of the servers."""

        async def waiting() -> Result:
            return await awaited

        return self._loop.run_until_complete(waiting())

    def _paths(self) -> SimpleNamespace:
        """Return what gateways ask of `os.path`."""
        return SimpleNamespace(exists=lambda path: path not in self.missing, realpath=str)

    def waker(self) -> MemoryWaker:
        return _LanWaker(self)

    # --- who serves, who connects ---------------------------------------------------------------

    @contextlib.contextmanager
    def _serving(self, server: Serving, *urls: str) -> Iterator[Any]:
        entered = server.serving(*urls)
        running = self.wait(entered.__aenter__())
        try:
            yield running
        except BaseException as error:
            if not self.wait(entered.__aexit__(type(error), error, error.__traceback__)):
                raise
        else:
            self.wait(entered.__aexit__(None, None, None))

    def client(
        self, target: str | int, source: str | None = None, *, timeout: float = PATIENCE
    ) -> LanClient:
        """Connect to a URL, or to a port of 127.0.0.1; over UDP, be ready to send there."""
        endpoint = parse(f"tcp://127.0.0.1:{target}" if isinstance(target, int) else target)
        is_udp = endpoint.transport == "udp"
        opened = self.open_datagrams if is_udp else self.connect
        end, _ = opened(endpoint.host, endpoint.port, source)
        assert end is not None
        talker = LanClient(self, end, timeout)
        talker.wait_to_write()
        if number := end.getsockopt(0, 0):
            end.close()
            raise OSError(number, f"{target}: {errno.errorcode[number]}")
        return talker


class _LanWaker(MemoryWaker):
    """Waits in the loop of the LAN, so that servers answer meanwhile."""

    def __init__(self, lan: Lan) -> None:
        super().__init__(lan.events, lan.descriptors)
        self._lan = lan

    def _wait(self, descriptor: int, events: int, most: int) -> bool:
        self._lan.until(lambda: self._is_woken or self._is_any(descriptor, events), most / 1000)
        if self._is_woken:
            raise WaitInterrupted
        return self._is_any(descriptor, events)

    def _sleep(self, seconds: float) -> None:
        self._lan.pass_time(max(0.0, seconds))


class LanClient:
    """A client that writes and reads what it likes, with the face of a blocking `socket.socket`."""

    def __init__(self, lan: Lan, end: MemorySocket, timeout: float) -> None:
        self.end: MemorySocket = end
        self.timeout: float = timeout
        self._lan = lan
        self._resets = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, data: bytes) -> int:
        self.wait_to_write()
        return self.end.send(data)

    def sendall(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[self.send(bytes(view)) :]

    def recv(self, size: int, flags: int = 0) -> bytes:
        if not self._lan.until(lambda: self.end.is_readable, self.timeout):
            raise TimeoutError("timed out")
        return self.end.recv(size, flags)

    def receive(self, size: int) -> bytes:
        """Return so many bytes; fewer if the connection is closed before."""
        data = b""
        while len(data) < size and (piece := self.recv(size - len(data))):
            data += piece
        return data

    def has_input(self) -> bool:
        """Return True if something can be read now."""
        return self.end.is_readable

    def can_write(self) -> bool:
        """Return True if the other side takes something now."""
        return self.end.fileno() in self._lan.descriptors.writable

    def is_closed(self) -> bool:
        """Wait until the other side has closed; return False if bytes come in place of that."""
        try:
            return self.recv(1) == b""
        except ConnectionResetError:
            return True

    def wait_to_write(self) -> None:
        if not self._lan.until(self.can_write, self.timeout):
            raise TimeoutError("timed out")

    def settimeout(self, seconds: float | None) -> None:
        self.timeout = PATIENCE if seconds is None else seconds

    def setsockopt(self, level: int, option: int, value: Any) -> None:
        if option == socket.SO_LINGER:
            self._resets = struct.unpack("ii", value) == (1, 0)

    def fileno(self) -> int:
        return self.end.fileno()

    def getsockname(self) -> tuple[str, int]:
        return self.end.address

    def shutdown(self, how: int) -> None:
        self.end.shutdown(how)

    def reset(self) -> None:
        """Close as a crash does: the other side gets ECONNRESET."""
        self.end.other.reset()
        self.end.close()

    def close(self) -> None:
        if self._resets and not self.end.is_closed:
            self.reset()
        self.end.close()


class LineEnd(Party):
    """Somebody on a line who writes what he likes, and hears what others write."""

    def __init__(self, line: SerialLine) -> None:
        self.heard: bytes = b""
        self._line = line
        line.join(self)

    def hear(self, data: bytes) -> None:
        self.heard += data

    def write(self, data: bytes) -> None:
        self._line.write(self, data)
