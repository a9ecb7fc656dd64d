"""
A serial port, opened and configured by libmodbus.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import struct
import termios
import time
from collections.abc import Iterator
from typing import ClassVar

from ..binding.library import check, ffi, lib, make
from ..protocol.checks import integer, seconds
from ..protocol.errors import ModbusConnectionError
from .link import Link

__all__ = ["SerialLink"]


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
        echo: whether all that is sent comes back, as from some two-wire
            transceivers; it is taken out of what is received.
        silence: seconds without a byte before anything is sent; None for the 3.5
            characters of the specification (1.75 ms above 19200 bit/s).

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
        echo: bool = False,
        silence: float | None = None,
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
        if not isinstance(echo, bool):
            raise TypeError(f"echo must be True or False, not {echo!r}")
        self.echo = echo
        # Serial line, 2.5.1.1: 3.5 characters of 11 bits, and no less than this.
        specified = 3.5 * 11 / self.baudrate if self.baudrate <= 19200 else 0.00175
        self.silence = specified if silence is None else seconds("silence", silence, 0, 1)
        self._awaited_echo = bytearray()
        self._held = bytearray()
        self._last_byte = 0.0
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
            if not self._connect():
                # glibc's tcsetattr reports EINVAL when it changed nothing and the
                # port lacks a setting: a pseudo-terminal has no parity, and has
                # the rest already where a program died without closing it.
                self._change_something()
                if not self._connect():
                    raise OSError(errno.EINVAL, "the port refuses these settings")
            self._watch(lib.modbus_get_socket(self.context))
            if self.baudrate not in self.baudrates:
                _set_odd_baudrate(self.descriptor, self.baudrate)
            self._set_direction_control()
            self.discard_input()

    def _connect(self) -> bool:
        ffi.errno = 0
        if lib.modbus_connect(self.context) == 0:
            return True
        if (number := ffi.errno) == errno.EINVAL:
            return False
        raise OSError(number, os.strerror(number))

    def _change_something(self) -> None:
        settings = termios.tcgetattr(self._guard)
        minimum = settings[6][termios.VMIN]
        settings[6][termios.VMIN] = 0 if minimum in (1, b"\x01") else 1
        termios.tcsetattr(self._guard, termios.TCSANOW, settings)

    def _take_port(self) -> int:
        """Lock the port: libmodbus would share it, and change the settings under the other."""
        guard = os.open(self.device, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            termios.tcgetattr(guard)  # before libmodbus may touch what is no port
            fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except (OSError, termios.error) as error:
            os.close(guard)
            if isinstance(error, BlockingIOError):
                raise OSError(errno.EBUSY, "in use by another program") from None
            if isinstance(error, termios.error):
                raise OSError(error.args[0], "not a serial port") from None
            raise
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
        self._forget_echo()
        # modbus_flush would throw away output, too.
        with contextlib.suppress(termios.error):
            termios.tcflush(self.descriptor, termios.TCIFLUSH)

    def receive(self, deadline: float) -> bytes:
        data = super().receive(deadline)
        if data:
            self._last_byte = time.monotonic()
        return self._without_echo(data) if self._awaited_echo else data

    def _without_echo(self, data: bytes) -> bytes:
        """Hold bytes back until they are the whole echo, or no echo at all."""
        self._held += data
        echo, size = self._awaited_echo, min(len(self._held), len(self._awaited_echo))
        is_echo = self._held[:size] == echo[:size]
        if is_echo and size < len(echo):
            return b""
        rest = bytes(self._held[size:] if is_echo else self._held)
        self._forget_echo()
        return rest

    def _forget_echo(self) -> None:
        self._awaited_echo.clear()
        self._held.clear()

    def wait_for_silence(self) -> None:
        """Wait until the line has been quiet for `silence`."""
        time.sleep(self.time_to_silence())

    def time_to_silence(self) -> float:
        """Give the seconds that are left of it."""
        return max(0.0, self._last_byte + self.silence - time.monotonic())

    def note_traffic(self) -> None:
        """Bytes went by that libmodbus sent or received."""
        self._last_byte = time.monotonic()

    def send(self, data: bytes, deadline: float) -> None:
        for pause in self.sending(data, deadline):
            time.sleep(pause)

    def sending(self, data: bytes, deadline: float) -> Iterator[float]:
        """As `send`, for whoever must not sleep: gives the seconds to wait before it goes on."""
        if self.echo:
            self._awaited_echo += data
        if self.rs485 in self.rts_modes:
            yield from self._sending_with_rts(data, deadline)
        else:
            super().send(data, deadline)
        # The driver takes the bytes at once; the last one leaves later.
        self._last_byte = time.monotonic() + len(data) * self.character

    def _sending_with_rts(self, data: bytes, deadline: float) -> Iterator[float]:
        self._set_rts(self.rs485 == "rts-up")
        try:
            yield self.rts_delay
            super().send(data, deadline)
            yield len(data) * self.character + self.rts_delay
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
