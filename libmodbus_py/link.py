"""
Links: a TCP connection or a serial port, as a descriptor inside a modbus_t.

A link opens, sends, receives and closes; what the bytes mean is not its
business. The modbus_t is there for whoever wants libmodbus to talk on the
same descriptor (`native`).

libmodbus opens and configures serial ports. TCP connects here and hands the
socket over: modbus_connect knows no host names, gives wrong errors, and aborts
the process on descriptors of 1024 and above.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import logging
import os
import select
import socket
import struct
import termios
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, ClassVar

from ._c import check, ffi, lib, make, microseconds
from .arguments import integer, seconds
from .errors import ModbusConnectionError, ModbusTimeoutError

__all__ = ["Link", "SerialLink", "TcpLink"]

logger = logging.getLogger(__name__)

# libmodbus waits with select: beyond this its 3.1.6 aborts, 3.1.12 refuses.
FD_SETSIZE = 1024


class Link(ABC):
    """
    One descriptor, opened and closed any number of times; deadlines are time.monotonic().

    Attributes:
        context: the modbus_t that holds the descriptor while the link is open.
        can_die_silently: whether it may seem open when the other side is gone.
        gone: what the end of the input means, and its errno.
    """

    can_die_silently: ClassVar[bool]
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
                raise _lost(error) from error

    def receive(self, deadline: float) -> bytes:
        """
        Give what is there, or wait for it; nothing if the deadline passes.

        Raises:
            ModbusConnectionError: the peer closed, or the port is gone.
        """
        if not self._wait(select.POLLIN, deadline):
            return b""
        try:
            data = os.read(self.descriptor, 4096)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise _lost(error) from error
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


def _lost(error: OSError) -> ModbusConnectionError:
    return ModbusConnectionError(error.strerror or str(error), errno=error.errno)


class TcpLink(Link):
    """
    A TCP connection.

    Args:
        host: a name, an IPv4 or an IPv6 address.
        port: 1..65535.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    can_die_silently = True
    gone = ("closed by the other side", errno.ECONNRESET)

    def __init__(self, host: str, port: int) -> None:
        if not isinstance(host, str):
            raise TypeError(f"host must be a string, not {type(host).__name__}")
        if not host.strip() or "\0" in host:
            raise ValueError(f"host must be a name or an address, not {host!r}")
        self.host = host
        self.port = integer("port", port, 1, 65535)
        self.context = make(lib.modbus_new_tcp(b"127.0.0.1", lib.MODBUS_TCP_DEFAULT_PORT))
        self._socket: socket.socket | None = None

    def __str__(self) -> str:
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    def open(self, deadline: float) -> None:
        connection = self._connect(deadline)
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        connection.setblocking(False)
        self._socket = connection
        self._watch(connection.fileno())
        check(lib.modbus_set_socket(self.context, self.descriptor))

    def _connect(self, deadline: float) -> socket.socket:
        try:
            addresses = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)
        except (OSError, UnicodeError) as error:
            number = getattr(error, "errno", None)
            text = getattr(error, "strerror", None) or error
            raise ModbusConnectionError(
                f"cannot resolve host {self.host!r}: {text}", errno=number
            ) from error
        last: OSError | None = None
        for *_, address in addresses:
            left = max(0.001, deadline - time.monotonic())
            try:
                return socket.create_connection((str(address[0]), self.port), left)
            except OSError as error:
                last = error
        assert last is not None  # getaddrinfo gives one address or raises
        number = errno.ETIMEDOUT if isinstance(last, TimeoutError) else last.errno
        text = os.strerror(number) if number else str(last)
        raise ModbusConnectionError(f"cannot connect to {self}: {text}", errno=number) from last

    def interrupt(self) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self.interrupt()
        self.abandon()

    def abandon(self) -> None:
        connection, self._socket, self.descriptor = self._socket, None, -1
        if connection is not None:
            lib.modbus_set_socket(self.context, -1)
            connection.close()

    def discard_input(self) -> None:
        with contextlib.suppress(ModbusConnectionError):
            while self.receive(0):
                pass

    def _write(self, data: bytes) -> int:
        assert self._socket is not None
        return self._socket.send(data)


class SerialLink(Link):
    """
    A serial port.

    Args:
        device: such as "/dev/ttyUSB0".
        baudrate: bits per second, 1..4000000; one that the port cannot do is
            refused when it is opened.
        parity: "N", "E" or "O".
        data_bits: 5..8.
        stop_bits: 1 or 2.
        rs485: None; "kernel" (the driver turns the transceiver round); "rts-up"
            or "rts-down" (RTS is set or cleared while we send).
        rts_delay: seconds between RTS and the first bit, and after the last;
            None for the length of one character.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.

    Source: modbus_new_rtu, modbus_rtu_set_serial_mode, modbus_rtu_set_rts.
    """

    can_die_silently = False
    gone = ("the port is gone", errno.EIO)

    # libmodbus 3.1.6..3.1.12 know these; any other they silently take for 9600.
    # fmt: off
    baudrates: ClassVar[frozenset[int]] = frozenset((
        110, 300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400,
        460800, 500000, 576000, 921600, 1000000, 1152000, 1500000, 2500000, 3000000,
        3500000, 4000000,
    ))
    # fmt: on
    rts_modes: ClassVar[dict[str, int]] = {
        "rts-up": lib.MODBUS_RTU_RTS_UP,
        "rts-down": lib.MODBUS_RTU_RTS_DOWN,
    }

    def __init__(
        self,
        device: str,
        baudrate: int = 19200,
        *,
        parity: str = "E",
        data_bits: int = 8,
        stop_bits: int = 1,
        rs485: str | None = None,
        rts_delay: float | None = None,
    ) -> None:
        if not isinstance(device, str):
            raise TypeError(f"device must be a string, not {type(device).__name__}")
        if not device or "\0" in device:
            raise ValueError(f"device must be the path of a serial port, not {device!r}")
        if parity not in ("N", "E", "O"):
            raise ValueError(f'parity must be "N", "E" or "O", not {parity!r}')
        if rs485 not in (None, "kernel", *self.rts_modes):
            raise ValueError(f'rs485 must be "kernel", "rts-up" or "rts-down", not {rs485!r}')
        self.device = device
        self.baudrate = integer("baudrate", baudrate, 1, 4_000_000)
        self.parity = parity
        self.data_bits = integer("data_bits", data_bits, 5, 8)
        self.stop_bits = integer("stop_bits", stop_bits, 1, 2)
        self.rs485 = rs485
        character = (1 + self.data_bits + (parity != "N") + self.stop_bits) / self.baudrate
        self.character = character
        self.rts_delay = character if rts_delay is None else seconds("rts_delay", rts_delay, 0, 1)
        self.context = make(
            lib.modbus_new_rtu(
                os.fsencode(device),
                self.baudrate if self.baudrate in self.baudrates else 9600,
                parity.encode(),
                self.data_bits,
                self.stop_bits,
            )
        )
        # Without a unit 3.1.6 aborts the process on the first read or write.
        check(lib.modbus_set_slave(self.context, 1))
        self._guard = -1

    def __str__(self) -> str:
        return self.device

    def open(self, deadline: float) -> None:
        with self._errors():
            self._guard = self._take_port()
            ffi.errno = 0
            if lib.modbus_connect(self.context) == -1:
                raise OSError(number := ffi.errno, os.strerror(number))
            self._watch(lib.modbus_get_socket(self.context))
            if self.baudrate not in self.baudrates:
                _set_odd_baudrate(self.descriptor, self.baudrate)
            self._set_direction_control()
            self.discard_input()

    def _take_port(self) -> int:
        """Lock the port: libmodbus would share it, and change the settings under the other."""
        guard = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            termios.tcgetattr(guard)  # before libmodbus may touch what is no port
            fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(guard)
            raise OSError(errno.EBUSY, "in use by another program") from None
        except termios.error as error:
            os.close(guard)
            raise OSError(error.args[0], "not a serial port") from None
        return guard

    def _set_direction_control(self) -> None:
        if self.rs485 == "kernel":
            if lib.modbus_rtu_set_serial_mode(self.context, lib.MODBUS_RTU_RS485) == -1:
                raise OSError(ffi.errno, "the driver has no RS-485 mode")
        elif self.rs485 is not None:
            lib.modbus_rtu_set_rts(self.context, self.rts_modes[self.rs485])
            lib.modbus_rtu_set_rts_delay(self.context, round(self.rts_delay * 1_000_000))

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.close()
            raise ModbusConnectionError(
                f"cannot open {self.device}: {error.strerror}", errno=error.errno
            ) from error

    def interrupt(self) -> None:
        """Nothing ends a read of a serial port but its deadline."""

    def close(self) -> None:
        if self.descriptor >= 0:
            self.descriptor = -1
            lib.modbus_close(self.context)  # restores the settings, too
        self._release()

    def abandon(self) -> None:
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            lib.modbus_set_socket(self.context, -1)
            os.close(descriptor)
        self._release()

    def _release(self) -> None:
        guard, self._guard = self._guard, -1
        if guard >= 0:
            os.close(guard)

    def discard_input(self) -> None:
        # modbus_flush would throw away output, too.
        with contextlib.suppress(termios.error):
            termios.tcflush(self.descriptor, termios.TCIFLUSH)

    def send(self, data: bytes, deadline: float) -> None:
        if self.rs485 not in self.rts_modes:
            super().send(data, deadline)
            return
        self._set_rts(self.rs485 == "rts-up")
        time.sleep(self.rts_delay)
        try:
            super().send(data, deadline)
            time.sleep(len(data) * self.character + self.rts_delay)
        finally:
            self._set_rts(self.rs485 != "rts-up")

    def _set_rts(self, on: bool) -> None:
        """As libmodbus does it, errors included: a port without RTS has nothing to turn round."""
        request = termios.TIOCMBIS if on else termios.TIOCMBIC
        with contextlib.suppress(OSError):
            fcntl.ioctl(self.descriptor, request, struct.pack("i", termios.TIOCM_RTS))

    def _write(self, data: bytes) -> int:
        return os.write(self.descriptor, data)


# struct termios2 and its ioctls of asm-generic/termbits.h; where they differ the
# ioctl fails, and the baud rate is refused.
_TERMIOS2 = struct.Struct("4IB19B2I")
_TCGETS2, _TCSETS2 = 0x802C542A, 0x402C542B
_CBAUD, _BOTHER = 0o010017, 0o010000


def _set_odd_baudrate(descriptor: int, baudrate: int) -> None:
    """Set a rate that has no constant of its own, and see whether the port took it."""
    try:
        fields = list(_TERMIOS2.unpack(fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size))))
        fields[2] = fields[2] & ~(_CBAUD | _CBAUD << 16) | _BOTHER
        fields[-2:] = baudrate, baudrate
        fcntl.ioctl(descriptor, _TCSETS2, _TERMIOS2.pack(*fields))
        *_, speed = _TERMIOS2.unpack(fcntl.ioctl(descriptor, _TCGETS2, bytes(_TERMIOS2.size)))
    except OSError as error:
        raise OSError(error.errno, f"baudrate {baudrate} refused: {error.strerror}") from None
    # A receiver tolerates 2 % (serial line, 2.4).
    if abs(speed - baudrate) > baudrate * 0.02:
        raise OSError(errno.EINVAL, f"baudrate {baudrate} refused: the port does {speed}")
