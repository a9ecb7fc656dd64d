"""Serial ports for clients and servers, opened and configured by libmodbus."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import termios
from collections.abc import Iterator
from operator import index
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, Unpack

from ..binding.library import check, ffi, lib, make
from ..protocol.errors import ModbusConnectionError
from ..protocol.mistakes import unknown_option
from ..protocol.scan import pause_between_frames
from .direction import Switch, switch_of
from .options import (
    SERIAL_DEFAULTS,
    SERIAL_OPTIONS,
    Rs485,
    SerialSettings,
    character_bits,
    parity_of,
)
from .port import RECEIVED_BYTES, Port, Silence, lost
from .serial_settings import check_settings, set_odd_baudrate
from .waiting import Steps, of_system

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions
    from .serial_devices import OpenDevice

# st_rdev of the ports that this process has open: the lock does not show which process has it.
_open_here: set[int] = set()


class SerialPort(Port):
    """
    A serial port, locked while it is open, so that no two programs use it at once.

    An echo is found out and removed by clients and servers, and passes here.
    Source: modbus_new_rtu, modbus_rtu_set_serial_mode, modbus_rtu_set_rts; serial line, 2.5.1.1.
    """

    # libmodbus 3.1.6..3.1.12 know these; any other they silently take for 9600.
    # fmt: off
    baudrates: ClassVar[frozenset[int]] = frozenset((
        110, 300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400,
        460800, 500000, 576000, 921600, 1000000, 1152000, 1500000, 2500000, 3000000,
        3500000, 4000000,
    ))
    # fmt: on

    @classmethod
    def of(cls, endpoint: Endpoint, _settings: ConnectionOptions) -> Self:
        """Return the port of a client for an endpoint."""
        return cls(endpoint.path, **endpoint.serial_settings)

    def __init__(self, device: str, **settings: Unpack[SerialSettings]) -> None:
        if not isinstance(device, str):
            raise TypeError(f"device must be a string, not {type(device).__name__}")
        if not device or "\0" in device:
            raise ValueError(f"device must be the path of a serial port, not {device!r}")
        if unknown := settings.keys() - SERIAL_OPTIONS.keys():
            raise unknown_option(min(unknown), [*SERIAL_OPTIONS])
        usual: Any = {name: settings.get(name, row.default) for name, row in SERIAL_OPTIONS.items()}
        for name, row in SERIAL_OPTIONS.items():
            row.check(name, usual[name])
        self.device = device
        self.parity: Literal["N", "E", "O"] = parity_of(usual["parity"])
        self.rs485: Rs485 | None = usual["rs485"]
        self._switch = switch_of(self.rs485)
        self.baudrate: int = index(usual["baudrate"])
        self.data_bits: int = index(usual["data_bits"])
        self.stop_bits: int = index(usual["stop_bits"])
        self.echo: bool | None = usual["echo"]
        bits = character_bits({**usual, "parity": self.parity})
        wait, silence = usual["rts_delay"], usual["silence"]
        self.character: float = bits / self.baudrate
        self.rts_delay: float = self.character if wait is None else float(wait)
        specified = pause_between_frames(self.baudrate, bits)
        self.silence: Silence = Silence(
            specified if silence is None else float(silence),
            self.character,
            self.rts_delay if self._switch is not None else 0.0,
        )
        self._sending: Iterator[float] = iter(())
        self._guards: list[int] = []
        self._number = 0
        self._process = 0
        self.context: Any = make(
            lib.modbus_new_rtu(
                os.fsencode(device),
                self.baudrate if self.baudrate in self.baudrates else 9600,
                self.parity.encode(),
                self.data_bits,
                self.stop_bits,
            )
        )
        # Without a unit 3.1.6 aborts the process on the first read or write.
        check(lib.modbus_set_slave(self.context, 1))

    def __str__(self) -> str:
        return self.device

    def opening(self, deadline: float) -> Steps[None]:
        self.open()
        yield from ()

    def open(self) -> None:
        """Open and configure the port, without waiting."""
        try:
            self._take_port()
            self._configure()
        except (OSError, termios.error) as error:
            self.close()
            if isinstance(error, ModbusConnectionError):
                raise
            if isinstance(error, OSError):
                of_system(error)
            number, reason = error.args[:2]
            if isinstance(error, termios.error) and number == errno.EINVAL:
                reason = "the port refuses these settings"
            raise ModbusConnectionError(
                f"cannot open {self.device}: {reason}", errno=number
            ) from error
        except BaseException:
            self.close()
            raise

    def _configure(self) -> None:
        self._process = os.getpid()
        if not self._connect():
            # glibc's tcsetattr reports EINVAL when it changed nothing and the
            # port lacks a setting: a pseudo-terminal has no parity, and has
            # the rest already where a program died without closing it.
            self._change_something()
            if not self._connect():
                raise OSError(errno.EINVAL, "the port refuses these settings")
        self._watch(lib.modbus_get_socket(self.context))
        if self.baudrate not in self.baudrates:
            set_odd_baudrate(self.descriptor, self.baudrate)
        self._check_settings(self.descriptor)
        if self.rs485 == "kernel":
            if lib.modbus_rtu_set_serial_mode(self.context, lib.MODBUS_RTU_RS485) == -1:
                raise OSError(ffi.errno, "the driver has no RS-485 mode")
        elif self._switch is not None:
            self._switch.open(self.descriptor)
        self.discard_input()

    def _check_settings(self, descriptor: int) -> None:
        wanted = {name: getattr(self, name) for name in SERIAL_DEFAULTS}
        check_settings(descriptor, self.device, wanted)

    def _connect(self) -> bool:
        ffi.errno = 0
        if lib.modbus_connect(self.context) == 0:
            return True
        if (number := ffi.errno) == errno.EINVAL:
            return False
        raise OSError(number, os.strerror(number))

    def _change_something(self) -> None:
        settings = termios.tcgetattr(self._guards[0])
        settings[0] ^= termios.IGNBRK  # libmodbus clears this
        termios.tcsetattr(self._guards[0], termios.TCSANOW, settings)

    def _take_port(self) -> None:
        """Lock the port, because libmodbus would change the settings of another program."""
        if self._is_open_here():  # asked first, because opening a port raises its RTS
            itself = "this program itself; one client (with for_unit) or context reaches all units"
            raise OSError(errno.EBUSY, f"in use by {itself}")
        guard = self._open_guard(os.O_RDWR)
        try:
            fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise self._in_use() from None
        self._number = os.fstat(guard).st_rdev
        _open_here.add(self._number)

    def _is_open_here(self) -> bool:
        try:
            return os.stat(self.device).st_rdev in _open_here
        except OSError:
            return False

    def _in_use(self) -> OSError:
        users = [user.program for user in users_of(self.device) if user.process != os.getpid()]
        names = ", ".join(dict.fromkeys(users)) or "another program"
        return OSError(errno.EBUSY, f"in use by {names}")

    def _open_guard(self, mode: int) -> int:
        """Return a descriptor of the port that the program waits for nothing to get."""
        self._release()
        flags = mode | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            # In one call, because a Ctrl-C after os.open would leave the port locked for ever.
            self._guards.extend(map(os.open, [self.device], [flags]))
        except PermissionError as error:
            raise OSError(
                error.errno, f"{error.strerror}; is this user in the group dialout?"
            ) from None
        except OSError as error:
            if error.errno == errno.EBUSY:  # another program has set TIOCEXCL
                raise self._in_use() from None
            raise
        (guard,) = self._guards
        try:
            termios.tcgetattr(guard)  # before the settings of a file that is no port are changed
        except termios.error as error:
            number = error.args[0]
            if number in (errno.ENOTTY, errno.EINVAL):
                raise OSError(number, "not a serial port") from None
            if number == errno.EIO and _lacks_hardware(self.device):
                raise OSError(number, "the system has no hardware for this port") from None
            raise
        return guard

    def close(self) -> None:
        """Close the port. A process that inherited it does not change its parent's settings."""
        self._sending = iter(())
        self.resume_at = None
        if self._process != os.getpid():
            self.abandon()
            return
        try:
            if self._switch is not None:
                self._switch.close()  # while the port is still open
        finally:
            self.descriptor: int = -1
            lib.modbus_close(self.context)  # restores the settings, too
            self._release()

    def abandon(self) -> None:
        if self._switch is not None:
            self._switch.abandon()
        self.descriptor = -1
        descriptor = lib.modbus_get_socket(self.context)
        if descriptor >= 0:
            lib.modbus_set_socket(self.context, -1)
            os.close(descriptor)
        self._release()

    def _release(self) -> None:
        # No call between these and os.close, because a signal handler may raise after any call.
        guards, self._guards = self._guards, []
        for guard in guards:
            os.close(guard)
            _open_here.discard(self._number)

    def receive(self) -> list[bytes]:
        try:
            data = os.read(self.descriptor, RECEIVED_BYTES)
        except BlockingIOError:
            return []
        except OSError as error:
            raise lost(error) from error
        if data:
            return [data]
        # An empty read alone does not prove that the port is gone, because VMIN is 0.
        events = dict(self._poll.poll(0)).get(self.descriptor, 0)
        if events & (select.POLLHUP | select.POLLERR):
            raise ModbusConnectionError("the port is gone", errno=errno.EIO)
        return []

    def discard_input(self) -> None:
        # modbus_flush would throw away output, too.
        with contextlib.suppress(termios.error):
            termios.tcflush(self.descriptor, termios.TCIFLUSH)

    def send(self, adus: list[bytes], now: float) -> None:
        data = b"".join(adus)
        if self._switch is None:
            self._write(data)
        else:
            self._sending = self._steps(data, self._switch)
            self.go_on(now)

    def go_on(self, now: float) -> None:
        pause = next(self._sending, None)
        self.resume_at = None if pause is None else now + pause

    def _steps(self, data: bytes, switch: Switch) -> Iterator[float]:
        """Send a frame, and yield the seconds to wait before each next step."""
        switch.turn(True)
        yield self.rts_delay
        self._write(data)
        yield len(data) * self.character + self.rts_delay
        switch.turn(False)

    def _write(self, data: bytes) -> None:
        """Write a frame; if the port takes only a part, the answer will be missing."""
        try:
            os.write(self.descriptor, data)
        except BlockingIOError:
            pass
        except OSError as error:
            raise lost(error) from error


def _lacks_hardware(device: str) -> bool:
    from .serial_devices import lacks_hardware  # which clients do not need

    return lacks_hardware(device)


def users_of(device: str) -> list[OpenDevice]:
    """Return the programs that have a port open, as far as this user may know."""
    from .serial_devices import open_devices  # which clients do not need

    path = os.path.realpath(device)
    return [user for user in open_devices()[0] if user.path == path]
