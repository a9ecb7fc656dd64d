"""
Ports whose system refuses something: opening, settings, reading, sending. What is said of it, and
that nothing stays open or locked.
"""

import errno
import fcntl
import os
import select
import socket
import struct
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Gateway, ModbusConnectionError, ModbusError, Route
from libmodbus_py.listen import listen
from libmodbus_py.ports import serial, serial_devices
from libmodbus_py.ports.serial import ReadOnlySerialPort, SerialPort
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.clients import ALL, asking


@pytest.fixture
def wire() -> Iterator[SerialWire]:
    with SerialWire() as wire:
        yield wire


@pytest.fixture
def port(wire: SerialWire) -> Iterator[SerialPort]:
    port = SerialPort(wire.client)
    port.open()
    yield port
    port.close()


def raising(number: int) -> Callable[..., Any]:
    def refuse(*_: object) -> Any:
        raise OSError(number, os.strerror(number))

    return refuse


@contextmanager
def failing(number: int, text: str = "") -> Iterator[None]:
    """Check that the block raises a ModbusConnectionError, in the words of the system if none."""
    with pytest.raises(ModbusConnectionError, match=text or os.strerror(number)) as caught:
        yield
    assert caught.value.errno == number


@contextmanager
def refusing(owner: Any, name: str, number: int) -> Iterator[None]:
    """Check that the block fails in the words of the system, whose function refuses meanwhile."""
    with pytest.MonkeyPatch.context() as patch, failing(number):
        patch.setattr(owner, name, raising(number))
        yield


def is_free(path: str) -> bool:
    """Return True if no program has a port open or locked."""
    port_ = SerialPort(path)
    port_.open()
    port_.close()
    return port_.descriptor == -1


class Connecting:
    """libmodbus, whose modbus_connect fails so many times with an error number."""

    def __init__(self, *numbers: int) -> None:
        self._lib = serial.lib
        self._numbers = list(numbers)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._lib, name)

    def modbus_connect(self, context: Any) -> int:
        if self._numbers:
            serial.ffi.errno = self._numbers.pop(0)
            return -1
        return int(self._lib.modbus_connect(context))


class TestSettings:
    def test_settings_that_are_refused_twice_are_an_error(self, wire: SerialWire, monkeypatch):
        port_ = SerialPort(wire.client)
        with monkeypatch.context() as patch:
            patch.setattr(serial, "lib", Connecting(errno.EINVAL, errno.EINVAL))
            with pytest.raises(ModbusConnectionError) as caught:
                port_.open()
        text = f"cannot open {wire.client}: the port refuses these settings"
        assert str(caught.value) == text
        assert caught.value.errno == errno.EINVAL
        assert port_.descriptor == -1
        assert is_free(wire.client)

    def test_settings_that_are_refused_once_are_accepted(self, wire: SerialWire, monkeypatch):
        """As glibc says of a pseudo-terminal, which has no parity."""
        monkeypatch.setattr(serial, "lib", Connecting(errno.EINVAL))
        port_ = SerialPort(wire.client)
        port_.open()
        assert port_.descriptor >= 0
        port_.close()

    @pytest.mark.parametrize("number", [errno.EIO, errno.ENXIO, errno.EMFILE])
    def test_another_settings_error_is_raised_at_once(self, number, wire: SerialWire, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr(serial, "lib", Connecting(number, errno.EDOM))
            with failing(number):
                SerialPort(wire.client).open()
        assert is_free(wire.client)

    def test_an_exception_while_opening_leaves_the_port_free(self, wire: SerialWire, monkeypatch):
        def interrupt(port: SerialPort) -> None:
            raise KeyboardInterrupt

        with monkeypatch.context() as patch:
            patch.setattr(SerialPort, "_configure", interrupt)
            with pytest.raises(KeyboardInterrupt):
                SerialPort(wire.client).open()
        assert is_free(wire.client)

    @pytest.mark.parametrize("number", [errno.ENOLCK, errno.EINTR])
    def test_a_lock_that_is_refused_is_named(self, number: int, wire: SerialWire) -> None:
        with refusing(fcntl, "flock", number):
            SerialPort(wire.client).open()
        assert is_free(wire.client)


class TestSettingsOfTheDriver:
    """tcsetattr returns 0 if a driver keeps another setting, as that of a 16550A does."""

    @pytest.fixture
    def rate(self, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
        """Make the system report a rate: pseudo-terminals keep any."""
        termios2, ioctl = struct.Struct("4IB19B2I"), fcntl.ioctl

        def report(rate: int) -> None:
            def read(descriptor: int, request: int, data: Any) -> Any:
                answer = ioctl(descriptor, request, data)
                if request == 0x802C542A:
                    answer = termios2.pack(*termios2.unpack(answer)[:-2], rate, rate)
                return answer

            monkeypatch.setattr(fcntl, "ioctl", read)

        return report

    @pytest.mark.parametrize(
        ("speed", "actual", "is_taken"),
        [
            (25_000, 25_000, True),
            (25_000, 25_500, True),
            (25_000, 24_500, True),
            (25_000, 25_501, False),
            (25_000, 24_499, False),
            (230_400, 9600, False),
            (4_000_000, 115_200, False),
            (921_600, 923_076, True),  # a CP2102
        ],
    )
    def test_a_rate_within_2_percent_is_accepted(
        self, speed: int, actual: int, is_taken: bool, rate: Callable[[int], None], wire: SerialWire
    ) -> None:
        rate(actual)
        port_ = SerialPort(wire.client, baudrate=speed)
        if is_taken:
            port_.open()
            port_.close()
        else:
            text = f"baudrate {speed} refused: the port does {actual}$"
            with failing(errno.EINVAL, text):
                port_.open()

    def test_the_highest_rate_of_a_plain_uart_is_named(
        self, rate: Callable[[int], None], wire: SerialWire, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(serial_devices, "highest_rate", lambda path: 115_200)
        rate(9600)
        with failing(errno.EINVAL, "the port does 9600, and at most 115200$"):
            SerialPort(wire.client, baudrate=230_400).open()

    def test_a_system_without_a_rate_to_read_back_is_accepted(self, wire: SerialWire, monkeypatch):
        """As on processors whose termios2 differs."""
        monkeypatch.setattr(serial, "_baudrate_of", lambda descriptor: None)
        port_ = SerialPort(wire.client, baudrate=230_400)
        port_.open()
        assert port_.descriptor >= 0
        port_.close()

    @pytest.mark.parametrize(
        ("settings", "text"),
        [
            ({"parity": "E"}, "parity E refused: the port has N"),
            ({"parity": "O"}, "parity O refused: the port has N"),
            ({"parity": "N", "data_bits": 7}, "data_bits 7 refused: the port has 8"),
        ],
    )
    def test_a_size_or_parity_that_hardware_does_not_take_is_refused(
        self, settings: Any, text: str, wire: SerialWire, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Pseudo-terminals refuse both, which is accepted, because they have no line."""
        port_ = SerialPort(wire.client, **settings)
        port_.open()
        port_.close()
        monkeypatch.setattr(serial, "PSEUDO_TERMINALS", ())
        with failing(errno.EINVAL, text):
            port_.open()

    def test_a_stop_bit_that_hardware_does_not_take_is_refused(self, wire: SerialWire, monkeypatch):
        port_ = SerialPort(wire.client, parity="N", stop_bits=2)
        monkeypatch.setattr(serial, "PSEUDO_TERMINALS", ())
        port_.open()
        port_.close()
        monkeypatch.setattr(termios, "CSTOPB", 0)
        with failing(errno.EINVAL, "stop_bits 2 refused: the port has 1"):
            port_.open()

    def test_a_port_that_refuses_a_rate_names_it(self, wire: SerialWire, monkeypatch) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(fcntl, "ioctl", raising(errno.EINVAL))
            with pytest.raises(ModbusConnectionError) as caught:
                SerialPort(wire.client, baudrate=25_000).open()
        assert "baudrate 25000 refused: Invalid argument" in str(caught.value)
        assert caught.value.errno == errno.EINVAL
        assert is_free(wire.client)


class TestOpening:
    def test_a_port_without_hardware_is_named_in_the_error(
        self, wire: SerialWire, monkeypatch, tmp_path
    ) -> None:
        """A ttyS of a kernel that lists more of them than there are: each call fails."""

        def refuse(descriptor: int) -> None:
            raise termios.error(errno.EIO, os.strerror(errno.EIO))

        monkeypatch.setattr(termios, "tcgetattr", refuse)
        with failing(errno.EIO, "Input/output error$"):
            SerialPort(wire.client).open()
        monkeypatch.setattr(serial_devices, "lacks_hardware", lambda path: path == wire.client)
        with failing(errno.EIO, "the system has no hardware for this port"):
            SerialPort(wire.client).open()

    def test_an_error_of_an_exclusive_port_names_its_process(self, wire: SerialWire) -> None:
        """TIOCEXCL of another program has this effect; not for root, who may run the tests."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(os, "open", raising(errno.EBUSY))
            with failing(errno.EBUSY, "in use by another program"):
                SerialPort(wire.client).open()

    def test_a_port_open_in_this_process_is_refused(self, port: SerialPort, monkeypatch):
        """Opening a port raises its RTS, which makes a transceiver send."""
        monkeypatch.setattr(os, "open", raising(errno.EDOM))
        with failing(errno.EBUSY, "in use by this program itself"):
            SerialPort(port.device).open()


class TestBytes:
    @pytest.mark.parametrize("number", [errno.EIO, errno.ENXIO, errno.ENODEV])
    def test_a_read_or_send_that_fails_is_a_lost_connection(self, number, port: SerialPort) -> None:
        with refusing(os, "read", number):
            port.receive()
        with refusing(os, "write", number):
            port.send([b"request"], 0.0)

    def test_a_read_that_would_block_returns_nothing(self, port: SerialPort, monkeypatch) -> None:
        monkeypatch.setattr(os, "read", raising(errno.EAGAIN))
        assert port.receive() == []

    @pytest.mark.parametrize("event", [select.POLLHUP, select.POLLERR])
    def test_an_empty_read_from_a_port_that_hung_up_is_an_error(
        self, event: int, port: SerialPort, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        class Poll:
            def poll(self, timeout: int) -> list[tuple[int, int]]:
                return [(port.descriptor, event)]

        monkeypatch.setattr(os, "read", lambda *_: b"")
        assert port.receive() == []
        port._poll = Poll()  # type: ignore[assignment]
        with failing(errno.EIO, "the port is gone"):
            port.receive()

    def test_a_frame_is_lost_at_a_port_with_a_full_buffer(self, port: SerialPort, monkeypatch):
        with monkeypatch.context() as patch:
            patch.setattr(os, "write", raising(errno.EAGAIN))
            port.send([b"request"], 0.0)
        assert port.resume_at is None
        assert not port.has_unsent


class TestReadOnly:
    @pytest.mark.parametrize("number", [errno.EINVAL, errno.EIO])
    def test_refused_settings_are_named_and_nothing_stays_open(
        self, number: int, wire: SerialWire, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def refuse(*_: object) -> None:
            raise termios.error(number, os.strerror(number))

        port_ = ReadOnlySerialPort(wire.client)
        with monkeypatch.context() as patch:
            # The other end of the wire is held open by this process itself.
            patch.setattr(serial_devices, "other_user", lambda *_: None)
            patch.setattr(termios, "tcsetattr", refuse)
            with pytest.raises(ModbusConnectionError) as caught:
                port_.open()
        text = "the port refuses these settings"
        reason = text if number == errno.EINVAL else os.strerror(number)
        assert str(caught.value) == f"cannot open {wire.client}: {reason}"
        assert caught.value.errno == number
        assert port_.descriptor == -1
        assert is_free(wire.client)


SCHEMES = ["tcp", "rtu+tcp", "ascii+tcp", "udp", "rtu+udp", "tls"]


@pytest.fixture
def dead_port(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A port of this machine where nothing listens, and from which every connection to it comes."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        port: int = bound.getsockname()[1]
    connect, connect_ex = socket.socket.connect, socket.socket.connect_ex

    def of_itself(method: Any) -> Any:
        def connected(sock: socket.socket, address: Any) -> Any:
            if address[1] == port:
                sock.bind(address)
            return method(sock, address)

        return connected

    monkeypatch.setattr(socket.socket, "connect", of_itself(connect))
    monkeypatch.setattr(socket.socket, "connect_ex", of_itself(connect_ex))
    yield port
    monkeypatch.undo()
    with socket.socket() as bound:  # the socket is unchanged: nothing waits in the system
        bound.bind(("127.0.0.1", port))


def test_the_system_connects_a_socket_to_itself(dead_port: int) -> None:
    """Without this effect of the system, the other tests here would show nothing."""
    with socket.socket() as sock:
        sock.connect(("127.0.0.1", dead_port))
        assert sock.getsockname() == sock.getpeername()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, bytes([1, 0, 0, 0, 0, 0, 0, 0]))


@ALL
@pytest.mark.parametrize("scheme", SCHEMES)
def test_clients_refuse_self_connection(kind: str, scheme: str, dead_port: int, tmp_path: Path):
    options: dict[str, Any] = {}
    if scheme == "tls":
        options["security"] = Pki(tmp_path).security(certificates.client())
    url = f"{scheme}://127.0.0.1:{dead_port}"
    with (
        pytest.raises(ModbusConnectionError, match="Connection refused") as caught,
        asking(kind, url, **options) as client,
    ):
        client.read_coils(0, 1)
    assert caught.value.errno == errno.ECONNREFUSED


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp"])
def test_gateways_refuse_self_connection(scheme, dead_port: int, caplog) -> None:
    gateway = Gateway([Route(f"{scheme}://127.0.0.1:{dead_port}")])
    with (
        gateway.background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0]) as client,
        pytest.raises(ModbusError),
    ):
        client.read_coils(0, 1)
    assert "Connection refused" in caplog.text


def test_taps_refuse_self_connection(dead_port: int, caplog: pytest.LogCaptureFixture) -> None:
    for host, reason in (
        ("127.0.0.1", "Connection refused"),
        ("a..b", "it cannot be the name of a host"),
    ):
        line = listen("rtu+tcp://127.0.0.1:0", between=f"rtu+tcp://{host}:{dead_port}")
        port = int(line.url.rpartition(":")[2])
        with line, socket.create_connection(("127.0.0.1", port)) as client:
            client.shutdown(socket.SHUT_WR)
            assert client.recv(100) == b""
        assert reason in caplog.text
