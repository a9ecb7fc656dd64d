"""
A link: a descriptor inside a modbus_t, that opens, sends, receives and closes.

What the bytes mean is not its business. The modbus_t is there for whoever wants
libmodbus to talk on the same descriptor.
"""

from __future__ import annotations

import os
import select
import time
from abc import ABC, abstractmethod
from typing import Any, ClassVar

from ..binding.library import check, lib, microseconds
from ..protocol.errors import ModbusConnectionError, ModbusTimeoutError

__all__ = ["TIMEOUTS_BEFORE_RECONNECT", "Link", "lost"]

# libmodbus waits with select: beyond this its 3.1.6 aborts, 3.1.12 refuses.
FD_SETSIZE = 1024

# A connection that is open but dead shows only by its timeouts.
TIMEOUTS_BEFORE_RECONNECT = 3


class Link(ABC):
    """
    One descriptor, opened and closed any number of times; deadlines are time.monotonic().

    Attributes:
        context: the modbus_t that holds the descriptor while the link is open.
        can_die_silently: whether it may seem open when the other side is gone.
        datagrams: whether bytes come in pieces that have nothing to do with each other.
        gone: what the end of the input means, and its errno.
    """

    can_die_silently: ClassVar[bool]
    datagrams: ClassVar[bool] = False
    gone: ClassVar[tuple[str, int]]
    context: Any
    descriptor = -1

    @property
    def is_open(self) -> bool:
        return self.descriptor >= 0

    @property
    def native(self) -> bool:
        """Whether libmodbus may receive on the descriptor."""
        return 0 <= self.descriptor < FD_SETSIZE

    @abstractmethod
    def open(self, deadline: float) -> None:
        """Raises ModbusConnectionError."""

    @abstractmethod
    def interrupt(self) -> None:
        """End a receive that another thread waits in, where that can be done."""

    @abstractmethod
    def close(self) -> None:
        """Put the line back as it was and close. Any number of times."""

    @abstractmethod
    def abandon(self) -> None:
        """Forget the descriptor without a trace on the line: it is a parent process's."""

    @abstractmethod
    def discard_input(self) -> None:
        """Throw away what was received and not read."""

    @abstractmethod
    def wait_for_silence(self) -> None:
        """Wait until the line may be sent on."""

    @abstractmethod
    def note_traffic(self) -> None:
        """Take note that libmodbus sent or received bytes."""

    @abstractmethod
    def _write(self, data: bytes) -> int: ...

    def prepare(self, timeout: float) -> None:
        """Set libmodbus's own timeout: one deadline for the whole answer."""
        check(lib.modbus_set_response_timeout(self.context, *microseconds(timeout)))
        # With (0, 0) the response timeout covers the rest of the answer, too;
        # else every byte may take that long anew.
        check(lib.modbus_set_byte_timeout(self.context, 0, 0))

    def send(self, data: bytes, deadline: float) -> None:
        """Raises ModbusConnectionError, ModbusTimeoutError."""
        view = memoryview(data)
        while view:
            try:
                view = view[self._write(bytes(view)) :]
            except BlockingIOError:
                if not self._wait(select.POLLOUT, deadline):
                    raise ModbusTimeoutError("the request could not be sent") from None
            except OSError as error:
                raise lost(error) from error

    def send_many(self, adus: list[bytes], deadline: float) -> None:
        """As `send`, with as few calls as the line allows."""
        self.send(b"".join(adus), deadline)

    def receive(self, deadline: float) -> bytes:
        """
        Give what is there, or wait for it; nothing if the deadline passes.

        Raises:
            ModbusConnectionError: the peer closed, or the port is gone.
        """
        return self._read(deadline, 4096)

    def receive_many(self, deadline: float) -> list[bytes]:
        """As `receive`, for many answers: the pieces that are there."""
        data = self.receive(deadline)
        return [data] if data else []

    def _read(self, deadline: float, size: int) -> bytes:
        if not self._wait(select.POLLIN, deadline):
            return b""
        try:
            data = os.read(self.descriptor, size)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise lost(error) from error
        if not data:
            raise ModbusConnectionError(self.gone[0], errno=self.gone[1])
        return data

    def has_input(self) -> bool:
        """Whether something waits to be read: bytes, or the news that the peer closed."""
        return bool(self._poll.poll(0))

    def _watch(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def _wait(self, events: int, deadline: float) -> bool:
        poll = self._poll
        if events != select.POLLIN:
            poll = select.poll()
            poll.register(self.descriptor, events)
        left = max(0.0, deadline - time.monotonic())
        # Rounded up: poll counts milliseconds, and 0 would spin until the deadline.
        return bool(poll.poll(-int(-left * 1000 // 1)))


def lost(error: OSError) -> ModbusConnectionError:
    return ModbusConnectionError(error.strerror or str(error), errno=error.errno)
