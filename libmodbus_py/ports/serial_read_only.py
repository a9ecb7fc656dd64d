"""Serial ports to listen at, where nothing is locked, and nothing is ever written."""

from __future__ import annotations

import contextlib
import os
import termios
from typing import Any

from ..protocol.checks import log_warning
from .serial import SerialPort, users_of
from .serial_settings import set_odd_baudrate


class ReadOnlySerialPort(SerialPort):
    """A serial port to listen at, with the settings of another program that has it open, if any."""

    _restored: list[Any] | None = None

    def _take_port(self) -> None:
        self._open_guard(os.O_RDONLY)

    def _configure(self) -> None:
        (descriptor,) = self._guards
        before = termios.tcgetattr(descriptor)
        self._process = os.getpid()
        if (other := _other_user(self.device, descriptor)) is None:
            self._restored = before
            self._set(descriptor)
            termios.tcflush(descriptor, termios.TCIFLUSH)
        else:
            text = "%s is open in %s, too: its settings stay, and it loses what is read here"
            log_warning(__name__, text, self.device, other)
        self._watch(descriptor)
        if other is None and self._switch is not None:
            # Opening a port sets RTS, which may make the transceiver send.
            self._switch.open(descriptor)

    def _set(self, descriptor: int) -> None:
        parities = {"N": 0, "E": termios.PARENB, "O": termios.PARENB | termios.PARODD}
        speed = getattr(termios, f"B{self.baudrate}", None)
        settings = termios.tcgetattr(descriptor)
        control = termios.CREAD | termios.CLOCAL | getattr(termios, f"CS{self.data_bits}")
        control |= parities[self.parity] | (termios.CSTOPB if self.stop_bits == 2 else 0)
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
        self._check_settings(descriptor)

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


def _other_user(device: str, descriptor: int) -> str | None:
    """Return another program that has the port open, as far as this user may know."""
    own = os.getpid()
    for user in users_of(device):
        if (user.process, user.descriptor) != (own, descriptor):
            return "this program" if user.process == own else user.program
    return None
