"""
A serial port that is only read: nothing is locked, and nothing is ever written.
"""

from __future__ import annotations

import contextlib
import errno
import os
import termios
from pathlib import Path
from typing import Any

from ..protocol.errors import ModbusConnectionError
from ..protocol.logs import HarmlessLogger
from ..system import set_odd_baudrate
from .serial import SerialPort

__all__ = ["ReadOnlySerialPort"]

logger: HarmlessLogger = HarmlessLogger(__name__)

_PARITIES = {"N": 0, "E": termios.PARENB, "O": termios.PARENB | termios.PARODD}
_DATA_BITS = {bits: getattr(termios, f"CS{bits}") for bits in (5, 6, 7, 8)}


class ReadOnlySerialPort(SerialPort):
    """
    A serial port to listen at; arguments as for `SerialPort`.

    The settings are applied, and restored on closing. If another program has the port open, that
    program's settings stay, and a warning is logged, because bytes read here are missing there.
    Use a separate port to listen without side effects.
    """

    def open(self) -> None:
        """
        Open the port for reading, and apply the settings unless another program uses it.

        Raises:
            ModbusConnectionError: the port cannot be opened, with errno.
        """
        self._restored: list[Any] | None = None
        flags = os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            self._guards.extend(map(os.open, [self.device], [flags]))
            self._set_up(self._guards[0])
        except (OSError, termios.error) as error:
            self.close()
            number, text = error.args[:2]
            if isinstance(error, termios.error) and number in (errno.ENOTTY, errno.EINVAL):
                text = "not a serial port, or one that refuses these settings"
            elif number == errno.EACCES:
                text += "; is this user in the group dialout?"
            raise ModbusConnectionError(
                f"cannot open {self.device}: {text}", errno=number
            ) from error
        except BaseException:
            self.close()
            raise

    def _set_up(self, descriptor: int) -> None:
        before = termios.tcgetattr(descriptor)
        self._process = os.getpid()
        if (other := _other_user(descriptor)) is None:
            self._restored = before
            self._set(descriptor)
            termios.tcflush(descriptor, termios.TCIFLUSH)
        else:
            logger.warning(
                "%s is open in %s, too: its settings stay, and it loses what is read here",
                self.device,
                other,
            )
        self._watch(descriptor)
        if other is None and self.rs485 in self.rts_modes:
            # Opening a port sets RTS, which may make the transceiver send.
            self._set_rts(self.rs485 != "rts-up")

    def _set(self, descriptor: int) -> None:
        speed = getattr(termios, f"B{self.baudrate}", None)
        settings = termios.tcgetattr(descriptor)
        control = termios.CREAD | termios.CLOCAL | _DATA_BITS[self.data_bits]
        control |= _PARITIES[self.parity] | (termios.CSTOPB if self.stop_bits == 2 else 0)
        settings[0] = termios.INPCK if self.parity != "N" else termios.IGNPAR
        settings[1], settings[2], settings[3] = 0, control, 0
        settings[4] = settings[5] = termios.B9600 if speed is None else speed
        settings[6][termios.VMIN], settings[6][termios.VTIME] = 0, 0
        try:
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        except termios.error:  # nothing changed, and something is lacking: see SerialPort
            self._change_something()
            termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        if speed is None:
            set_odd_baudrate(descriptor, self.baudrate)

    def send(self, adus: list[bytes], now: float) -> None:
        raise RuntimeError("this port is only read")

    def close(self) -> None:
        if self._guards and self._restored is not None and self._process == os.getpid():
            with contextlib.suppress(termios.error, OSError):
                termios.tcsetattr(self._guards[0], termios.TCSANOW, self._restored)
        self._restored = None
        self.abandon()

    def abandon(self) -> None:
        # libmodbus holds nothing here, and its context may be gone during garbage collection.
        self.descriptor = -1
        self._release()


def _other_user(descriptor: int) -> str | None:
    """Return the name of another process that has the port open, as far as this user may know."""
    number = os.fstat(descriptor).st_rdev
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        process = link.parts[2]
        if process == str(os.getpid()) and link.name == str(descriptor):
            continue
        with contextlib.suppress(OSError):
            if os.readlink(link).startswith("/dev/") and os.stat(link).st_rdev == number:
                name = Path("/proc", process, "comm").read_text().strip()
                return "this program" if process == str(os.getpid()) else f"{name} ({process})"
    return None
