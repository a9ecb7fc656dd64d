"""Serial ports for clients and servers, opened and configured by libmodbus."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import select
import struct
import termios
from collections.abc import Iterator
from operator import index
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, Unpack

from ..binding.library import check, ffi, lib, make
from ..protocol.checks import log_warning
from ..protocol.errors import ModbusConnectionError
from ..protocol.mistakes import unknown_option
from ..protocol.scan import pause_between_frames
from .direction import Switch, switch_of
from .options import SERIAL_OPTIONS, Rs485, SerialSettings, character_bits, parity_of
from .port import RECEIVED_BYTES, Port, Silence, lost
from .waiting import Steps, of_system

if TYPE_CHECKING:
    from .endpoint import Endpoint
    from .options import ConnectionOptions

REFUSED = "the port refuses these settings"

# st_rdev of the ports that this process has open: the lock does not show which process has it.
_open_here: set[int] = set()


class SerialPort(Port):
    """
    A serial port, locked while it is open, so that no two programs use it at once.

    An echo is found out and removed by clients and servers, and passes here.
    Source: modbus_new_rtu, modbus_rtu_set_serial_mode, modbus_rtu_set_rts; serial line, 2.5.1.1.
    """

    # The rates that libmodbus 3.1.6..3.1.12 knows; it takes 9600 for any other, silently.
    baudrates: ClassVar[frozenset[int]] = frozenset((
        110, 300, 600, 1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200, 230400,
        460800, 500000, 576000, 921600, 1000000, 1152000, 1500000, 2500000, 3000000,
        3500000, 4000000,
    ))  # fmt: skip

    @classmethod
    def of(cls, endpoint: Endpoint, _settings: ConnectionOptions) -> Self:
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
        bits = character_bits({**usual, "parity": self.parity})
        wait, silence = usual["rts_delay"], usual["silence"]
        self.character: float = bits / self.baudrate
        self.rts_delay: float = self.character if wait is None else float(wait)
        quiet = pause_between_frames(self.baudrate, bits) if silence is None else float(silence)
        turn = 0.0 if self._switch is None else self.rts_delay
        self.silence: Silence = Silence(quiet, self.character, turn)
        self._sending: Iterator[float] = iter(())
        self._guards: list[int] = []
        self._number = 0
        self._process = 0
        rate = self.baudrate if self.baudrate in self.baudrates else 9600
        line = rate, self.parity.encode(), self.data_bits, self.stop_bits
        self.context: Any = make(lib.modbus_new_rtu(os.fsencode(device), *line))
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
        except BaseException as error:
            self.close()
            is_ours = isinstance(error, ModbusConnectionError)
            if is_ours or not isinstance(error, OSError | termios.error):
                raise
            if isinstance(error, OSError):
                of_system(error)
            number, reason = error.args[:2]
            if isinstance(error, termios.error) and number == errno.EINVAL:
                reason = REFUSED
            text = f"cannot open {self.device}: {reason}"
            raise ModbusConnectionError(text, errno=number) from error

    def _configure(self) -> None:
        self._process = os.getpid()
        if not self._connect():
            # glibc's tcsetattr reports EINVAL when it changed nothing and the
            # port lacks a setting: a pseudo-terminal has no parity, and has
            # the rest already where a program died without closing it.
            self._change_something()
            if not self._connect():
                raise OSError(errno.EINVAL, REFUSED)
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
        """
        Raise an OSError for a setting that the open port did not take.

        Linux reports no error if a driver cannot make a setting: `tcsetattr` returns 0, and the
        port has another one, usually that of before. The rates of a port are only known by
        trying them; of a plain UART the highest one is known.
        """
        control = termios.tcgetattr(descriptor)[2]
        odd_or_even = "O" if control & termios.PARODD else "E"
        actual = {
            "parity": odd_or_even if control & termios.PARENB else "N",
            "data_bits": DATA_BITS[control & termios.CSIZE],
            "stop_bits": 2 if control & termios.CSTOPB else 1,
        }
        if os.major(os.fstat(descriptor).st_rdev) not in PSEUDO_TERMINALS:
            for name, value in actual.items():
                if value != (setting := getattr(self, name)):
                    reason = f"{name} {setting} refused: the port has {value}"
                    raise OSError(errno.EINVAL, reason)
        rate = _baudrate_of(descriptor) or self.baudrate
        # A receiver tolerates 2 % (serial line, 2.4).
        if abs(rate - self.baudrate) > self.baudrate * 0.02:
            from .serial_devices import highest_rate  # imported here: only this error needs it

            highest = highest_rate(self.device)
            limit = f", and at most {highest}" if highest else ""
            reason = f"baudrate {self.baudrate} refused: the port does {rate}{limit}"
            raise OSError(errno.EINVAL, reason)

    def _connect(self) -> bool:
        ffi.errno = 0
        if lib.modbus_connect(self.context) == 0:
            return True
        if (number := ffi.errno) == errno.EINVAL:
            return False
        raise OSError(number, os.strerror(number))

    def _change_something(self) -> None:
        settings = termios.tcgetattr(self._guards[0])
        settings[0] ^= termios.IGNBRK  # libmodbus clears this flag
        termios.tcsetattr(self._guards[0], termios.TCSANOW, settings)

    def _take_port(self) -> None:
        """Lock the port, because libmodbus would change the settings of another program."""
        is_open_here = False
        with contextlib.suppress(OSError):
            is_open_here = os.stat(self.device).st_rdev in _open_here
        if is_open_here:  # asked first, because opening a port raises its RTS
            itself = "this program itself; one client (with for_unit) or context reaches all units"
            raise OSError(errno.EBUSY, f"in use by {itself}")
        guard = self._open_guard(os.O_RDWR)
        try:
            fcntl.flock(guard, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise self._in_use() from None
        self._number = os.fstat(guard).st_rdev
        _open_here.add(self._number)

    def _in_use(self) -> OSError:
        from .serial_devices import other_programs  # which clients do not need otherwise

        return OSError(errno.EBUSY, f"in use by {other_programs(self.device)}")

    def _open_guard(self, mode: int) -> int:
        """Open the port without waiting for a modem, and return the descriptor."""
        self._release()
        flags = mode | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC
        try:
            # In one call, because a Ctrl-C after os.open would leave the port locked for ever.
            self._guards.extend(map(os.open, [self.device], [flags]))
        except PermissionError as error:
            reason = f"{error.strerror}; is this user in the group dialout?"
            raise OSError(error.errno, reason) from None
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
            from .serial_devices import lacks_hardware  # which clients do not need otherwise

            if number == errno.EIO and lacks_hardware(self.device):
                raise OSError(number, "the system has no hardware for this port") from None
            raise
        return guard

    def close(self) -> None:
        self._sending = iter(())
        self.resume_at = None
        if self._process != os.getpid():  # a child: the settings are its parent's
            self.abandon()
            return
        try:
            if self._switch is not None:
                self._switch.close()  # while the port is still open
        finally:
            self.descriptor: int = -1
            lib.modbus_close(self.context)  # modbus_close restores the settings, too
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
        # modbus_flush would discard output, too.
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


class ReadOnlySerialPort(SerialPort):
    """A serial port to listen at, with the settings of another program that has it open, if any."""

    _restored: list[Any] | None = None

    def _take_port(self) -> None:
        self._open_guard(os.O_RDONLY)

    def _configure(self) -> None:
        (descriptor,) = self._guards
        before = termios.tcgetattr(descriptor)
        self._process = os.getpid()
        from .serial_devices import other_user

        if (other := other_user(self.device, descriptor)) is None:
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
        # libmodbus owns no descriptor here; its context may be freed during garbage collection.
        self.descriptor = -1
        self._release()


# --- settings that neither libmodbus nor termios makes or checks ----------------------------------

# struct termios2, TCGETS2 and TCSETS2 of asm-generic/termbits.h, whose BOTHER is CBAUDEX; where
# they differ, the ioctl fails.
TERMIOS2 = struct.Struct("4IB19B2I")
TCGETS2, TCSETS2 = 0x802C542A, 0x402C542B

# Numbers of pseudo-terminals (Unix98 slaves of Linux's devices.txt), which have one character size,
# no parity and no line on which it would matter.
PSEUDO_TERMINALS = range(136, 144)

DATA_BITS = {termios.CS5: 5, termios.CS6: 6, termios.CS7: 7, termios.CS8: 8}


def set_odd_baudrate(descriptor: int, baudrate: int) -> None:
    """Set a rate without a constant; raise OSError if the port, or the system, takes none."""
    try:
        fields = list(TERMIOS2.unpack(fcntl.ioctl(descriptor, TCGETS2, bytes(TERMIOS2.size))))
        fields[2] = fields[2] & ~(termios.CBAUD | termios.CIBAUD) | termios.CBAUDEX
        fields[-2:] = baudrate, baudrate
        fcntl.ioctl(descriptor, TCSETS2, TERMIOS2.pack(*fields))
    except OSError as error:
        raise OSError(error.errno, f"baudrate {baudrate} refused: {error.strerror}") from None


def _baudrate_of(descriptor: int) -> int | None:
    """Return the baud rate of a port in its driver; None if Linux does not report it."""
    try:
        data = fcntl.ioctl(descriptor, TCGETS2, bytes(TERMIOS2.size))
    except OSError:
        return None
    return int(TERMIOS2.unpack(data)[-1])
