"""
The direction of an RS-485 transceiver, where the driver does not switch it: RTS, a line of a GPIO
chip, or a function of the user.

A switch is turned before and behind each frame. It receives while a port is open and nothing is
sent, and after the port was closed, whatever failed or was interrupted meanwhile.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import struct
import termios
from collections.abc import Callable
from importlib import import_module
from typing import Any

from ..protocol.checks import finished, log_failure
from ..protocol.errors import ModbusConnectionError
from ..version import what_is_missing
from .options import GPIO_LINE, Rs485
from .waiting import of_system

RTS = {"rts-up": True, "rts-down": False}
"""Mode -> whether RTS is set while sending."""


def switch_of(rs485: Rs485 | None) -> Switch | None:
    """
    Return the switch of the option `rs485`; None without one, or if the driver has it.

    Raises:
        ImportError: the package for GPIO lines is missing.
    """
    if rs485 is None or rs485 == "kernel":
        return None
    if not isinstance(rs485, str):
        return Switch(rs485)
    line = GPIO_LINE.fullmatch(rs485)
    return RtsSwitch(RTS[rs485]) if line is None else GpioSwitch(*line.groups())


class Switch:
    """A function that is called with True before each frame, and with False behind it."""

    _is_receiving = True  # False from an attempt to send until one to receive succeeded

    def __init__(self, function: Callable[[bool], object]) -> None:
        self._function = function

    def open(self, _descriptor: int) -> None:
        """Begin to receive, at an open port; raise ModbusConnectionError if that fails."""
        self.turn(False)

    def turn(self, is_sending: bool) -> None:
        """Let the transceiver send or receive; raise ModbusConnectionError if that fails."""
        if is_sending:
            self._is_receiving = False
        try:
            finished("rs485", self._function(is_sending))
        except Exception as error:
            if not (is_sending or self._is_receiving):  # the request may have been answered
                log_failure(__name__, "the RS-485 transceiver may still send")
            raise failure(error) from error
        if not is_sending:
            self._is_receiving = True

    def close(self) -> None:
        """Receive, if that is not so already; may be called repeatedly."""
        if not self._is_receiving:
            with contextlib.suppress(ModbusConnectionError):
                self.turn(False)
        self.abandon()

    def abandon(self) -> None:
        """Forget the transceiver in a forked child: it is the parent's."""
        self._is_receiving = True


class RtsSwitch(Switch):
    """RTS of the port, as libmodbus sets it: a port without RTS needs no turning."""

    _descriptor = -1

    def __init__(self, is_up: bool) -> None:
        super().__init__(self._set)
        self._is_up = is_up

    def open(self, descriptor: int) -> None:
        self._descriptor = descriptor
        super().open(descriptor)

    def abandon(self) -> None:
        super().abandon()
        self._descriptor = -1

    def _set(self, is_sending: bool) -> None:
        request = termios.TIOCMBIS if is_sending == self._is_up else termios.TIOCMBIC
        try:
            fcntl.ioctl(self._descriptor, request, struct.pack("i", termios.TIOCM_RTS))
        except OSError as error:
            of_system(error)


class GpioSwitch(Switch):
    """A line of a GPIO chip, which is this program's while the port is open."""

    _request: Any = None

    def __init__(self, chip: str, line: str) -> None:
        super().__init__(self._set)
        self._chip = chip
        self._line: int | str = int(line) if line.isdecimal() else line
        try:
            self._gpiod = import_module("gpiod")
            self._words = import_module("gpiod.line")  # which the version in Debian 12 lacks
        except ImportError as error:
            raise ImportError(what_is_missing("rs485=gpio:...", "gpio")) from error

    def open(self, descriptor: int) -> None:
        settings = self._gpiod.LineSettings(
            direction=self._words.Direction.OUTPUT, output_value=self._words.Value.INACTIVE
        )
        try:
            self._request = self._gpiod.request_lines(
                self._chip, {self._line: settings}, consumer="libmodbus-py"
            )
        except Exception as error:
            raise failure(error, f", {self._chip}/{self._line}") from error

    def _set(self, is_sending: bool) -> None:
        value = self._words.Value.ACTIVE if is_sending else self._words.Value.INACTIVE
        self._request.set_value(self._line, value)

    def abandon(self) -> None:
        super().abandon()
        request, self._request = self._request, None
        if request is not None:
            request.release()


def failure(error: Exception, which: str = "") -> ModbusConnectionError:
    number = getattr(error, "errno", None) or errno.EIO
    return ModbusConnectionError(f"rs485{which}: {error!r}", errno=number)
