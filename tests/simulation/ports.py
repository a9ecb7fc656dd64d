"""
The ports of clients on a network in memory, and what blocking clients wait with there.

All but the system's part is the package's own: `TcpPort`, for example, sends and receives through a
socket in memory.
"""

import errno
import os
import socket
from collections.abc import Callable
from functools import cache
from typing import Any, cast

from libmodbus_py.ports.port import port_class
from libmodbus_py.ports.schemes import Transport
from libmodbus_py.ports.waiting import (
    READ,
    WRITE,
    Ready,
    Steps,
    WaitInterrupted,
    Waker,
    milliseconds,
)
from libmodbus_py.protocol.errors import ModbusConnectionError

from .events import Events
from .loop import Descriptors
from .sockets import MemorySocket

Connect = Callable[[], tuple[MemorySocket | None, int]]
"""Returns a socket to the address of a port, connected once it is writable; or an errno."""


class MemoryWaker(Waker):
    """Waits by letting simulated time pass: whatever happens meanwhile happens within the wait."""

    def __init__(self, events: Events, descriptors: Descriptors) -> None:
        self._events = events
        self._descriptors = descriptors
        self._is_woken = False
        self._watched = -1
        self.now = lambda: events.now
        self.sleep = self._sleep

    def renew(self) -> None:
        self._is_woken = False

    def wake(self) -> None:
        self._is_woken = True

    def clear(self) -> None:
        self._is_woken = False

    def close(self) -> None:
        pass

    __del__ = close

    def watch(self, descriptor: int) -> None:
        self._watched = descriptor

    def is_ready(self, seconds: float) -> bool:
        return self._wait(self._watched, READ, milliseconds(seconds))

    def wait(self, descriptor: int, events: int, deadline: float) -> bool:
        return self._wait(descriptor, events, milliseconds(deadline - self._events.now))

    def _wait(self, descriptor: int, events: int, most: int) -> bool:
        until = self._events.now + most / 1000
        while not self._is_woken:
            if self._is_any(descriptor, events):
                return True
            if self._events.now >= until:
                return False
            self._events.advance(until)
        raise WaitInterrupted

    def _is_any(self, descriptor: int, events: int) -> bool:
        can_read = events & READ and descriptor in self._descriptors.readable
        return bool(can_read or (events & WRITE and descriptor in self._descriptors.writable))

    def _sleep(self, seconds: float) -> None:
        until = self._events.now + max(0.0, seconds)
        while self._events.now < until:
            self._events.advance(until)


class _InMemory:
    """What all kinds of sockets have in common; a mixin in front of `SocketPort`."""

    descriptor: int

    def join(self, descriptors: Descriptors, connect: Connect, waker: Callable[[], Waker]) -> None:
        """Use a network in memory."""
        self._descriptors = descriptors
        self._connect = connect
        self._waker = waker

    def waker(self) -> Waker:
        return self._waker()

    def has_input(self) -> bool:
        return self.descriptor in self._descriptors.readable

    def _watch(self, descriptor: int) -> None:
        self.descriptor = descriptor

    def _connected(self, deadline: float) -> Steps[socket.socket]:
        end, number = self._connect()
        if end is not None:
            try:
                is_ready = yield Ready(end.fileno(), WRITE, deadline)
                number = end.getsockopt(0, 0) if is_ready else errno.ETIMEDOUT
            except BaseException:
                end.close()
                raise
        if number:
            if end is not None:
                end.close()
            reason = f"cannot connect to {self}: {os.strerror(number)}"
            raise ModbusConnectionError(reason, errno=number)
        return cast(socket.socket, end)


@cache
def memory_port(transport: Transport) -> Any:
    """Return the class of ports of a transport, on a network in memory; not for serial ports."""
    kind = port_class(transport)
    return type(f"Memory{kind.__name__}", (_InMemory, kind), {})
