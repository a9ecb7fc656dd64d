"""Serial ports: silence, settings, locks, and reads that return no bytes."""

import errno
import fcntl
import gc
import json
import os
import pty
import subprocess
import sys
import termios
import time
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.cli.find import ports
from libmodbus_py.ports.port import Silence
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.ports.serial_devices import SerialDevice, serial_devices
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.golden import Refused
from tests.support.peers import FakeUnit, until


@pytest.fixture
def wire() -> Iterator[SerialWire]:
    with SerialWire() as wire:
        yield wire


@pytest.fixture
def port(wire: SerialWire) -> Iterator[SerialPort]:
    port = SerialPort(wire.client, baudrate=115200)
    port.open()
    yield port
    port.close()


def test_after_a_byte_the_line_must_be_quiet() -> None:
    silence = Silence(0.004)
    assert silence.over_at == 0
    silence.heard(10)
    assert silence.over_at == pytest.approx(10.004)


def test_the_time_of_received_bytes_counts_before_the_silence() -> None:
    """8 characters of 1 ms."""
    silence = Silence(0.004, character=0.001)
    silence.sent(8, 10)
    assert silence.over_at == pytest.approx(10.012)
    silence.heard(10.009)  # received bytes show that all was sent
    assert silence.over_at == pytest.approx(10.013)


def test_a_line_with_a_turnaround_delay_is_silent_only_after_it() -> None:
    silence = Silence(0.004, character=0.001, turn=0.1)
    silence.sent(8, 10)
    assert silence.over_at == pytest.approx(10.212)
    silence.heard(10.05)
    assert silence.over_at == pytest.approx(10.208)


@each_case(
    ("settings", "silence", "character"),
    [
        ({"baudrate": 9600}, 38.5 / 9600, 11 / 9600),
        ({"baudrate": 19200, "parity": "N"}, 38.5 / 19200, 10 / 19200),
        ({"baudrate": 38400, "stop_bits": 2}, 0.00175, 12 / 38400),
        ({"baudrate": 9600, "data_bits": 7, "silence": 0}, 0, 10 / 9600),
        ({"silence": 0.5}, 0.5, 11 / 19200),
    ],
)
def test_silence_and_characters_are_those_of_the_specification(settings, silence, character):
    port_ = SerialPort("/dev/x", **settings)
    assert port_.silence.seconds == pytest.approx(silence)
    assert port_.silence.character == pytest.approx(character)


def test_an_invalid_setting_is_named(refused: Refused) -> None:
    refused("wrong_settings.txt", lambda settings: SerialPort("/dev/x", **settings))


def test_settings_are_restored_when_the_port_is_closed() -> None:
    master, slave = pty.openpty()
    try:
        tty.setcbreak(slave)
        before = termios.tcgetattr(slave)
        port_ = SerialPort(os.ttyname(slave), baudrate=57600, stop_bits=2)
        port_.open()
        during = termios.tcgetattr(slave)
        assert during[4] == termios.B57600
        assert during[2] & termios.CSTOPB
        assert not during[3] & (termios.ICANON | termios.ECHO)
        port_.close()
        port_.close()
        assert termios.tcgetattr(slave) == before
    finally:
        os.close(master)
        os.close(slave)


@each_case("baudrate", [50, 1800, 14400, 56000, 128000, 250000, 2000000])
def test_a_baudrate_unknown_to_libmodbus_is_set(baudrate: int) -> None:
    with FakeUnit() as unit:
        port_ = SerialPort(unit.path, baudrate=baudrate)
        port_.open()
        termios2 = fcntl.ioctl(unit._slave, 0x802C542A, bytes(44))
        assert int.from_bytes(termios2[-4:], sys.byteorder) == baudrate
        port_.close()


def test_kernel_rs485_on_a_port_without_it_is_refused(wire: SerialWire) -> None:
    with pytest.raises(ModbusConnectionError, match="RS-485") as caught:
        SerialPort(wire.client, rs485="kernel").open()
    assert caught.value.errno == errno.ENOTTY
    port_ = SerialPort(wire.client)  # and it was left
    port_.open()
    port_.close()


@each_case(
    ("device", "number"),
    [
        ("/dev/no-such-port", errno.ENOENT),
        ("/", errno.EISDIR),
        ("/dev/null", errno.ENOTTY),
        (__file__, errno.ENOTTY),
    ],
)
def test_a_path_that_is_no_serial_port_is_refused(device: str, number: int) -> None:
    with pytest.raises(ModbusConnectionError) as caught:
        SerialPort(device).open()
    assert caught.value.errno == number
    assert device in str(caught.value)


def test_a_port_that_this_user_may_not_open_names_the_group(monkeypatch, wire: SerialWire) -> None:
    """Nothing is forbidden to root, who may run the tests."""

    def forbidden(path: str, flags: int) -> int:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), path)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", forbidden)
        with pytest.raises(ModbusConnectionError, match=r"Permission denied.*dialout") as caught:
            SerialPort(wire.client).open()
    assert caught.value.errno == errno.EACCES


def test_an_error_of_a_second_client_on_a_port_suggests_for_unit(
    port: SerialPort, wire: SerialWire, tmp_path: Path
) -> None:
    link = tmp_path / "ttyPLC"
    link.symlink_to(wire.client)
    before = termios.tcgetattr(port.descriptor)
    for name in (wire.client, str(link)):
        with pytest.raises(ModbusConnectionError, match="this program itself; one") as caught:
            SerialPort(name, baudrate=9600).open()
        assert caught.value.errno == errno.EBUSY
        assert termios.tcgetattr(port.descriptor) == before
    port.close()
    port.open()


HOLD = """
import sys
from libmodbus_py.ports.serial import SerialPort
port = SerialPort(sys.argv[1])
port.open()
print("open", flush=True)
sys.stdin.read()
"""


def test_a_port_of_another_program_is_an_error_until_that_program_ends(wire: SerialWire) -> None:
    """The program dies without closing the port, and leaves its settings."""
    holding = [sys.executable, "-c", HOLD, wire.client]
    with subprocess.Popen(holding, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"open\n"
        with pytest.raises(ModbusConnectionError, match=rf"in use by .*\({other.pid}\)$") as caught:
            SerialPort(wire.client).open()
        assert caught.value.errno == errno.EBUSY
        other.kill()
    for _ in range(2):
        port_ = SerialPort(wire.client)
        port_.open()
        port_.close()


def test_a_fork_does_not_change_the_port(port: SerialPort, wire: SerialWire) -> None:
    before = termios.tcgetattr(port.descriptor)
    child = os.fork()
    if child == 0:
        port.close()
        os._exit(port.descriptor != -1)
    assert os.waitpid(child, 0)[1] == 0
    assert termios.tcgetattr(port.descriptor) == before
    port.send([b"still here"], time.monotonic())
    until(lambda: wire.sent_by("client") == b"still here")
    with pytest.raises(ModbusConnectionError, match="in use"):
        SerialPort(wire.client).open()


def test_a_port_that_is_abandoned_while_it_sends_sets_no_rts(wire: SerialWire) -> None:
    """As in a forked child: RTS is its parent's; nor does what was begun complain later."""
    port_ = SerialPort(wire.client, rs485="rts-up", rts_delay=0.02)
    port_.open()
    port_.send([b"never sent"], time.monotonic())
    assert port_.resume_at is not None
    port_.abandon()
    port_.close()
    gc.collect()
    assert wire.sent_by("client") == b""


def heard(port: SerialPort, wire: SerialWire, data: bytes) -> None:
    """Write bytes, and wait until the port can read them."""
    other = os.open(wire.server, os.O_WRONLY | os.O_NOCTTY)
    os.write(other, data)
    until(port.has_input)
    os.close(other)


def test_bytes_flushed_between_poll_and_read_do_not_count_as_a_closed_port(
    port: SerialPort, wire: SerialWire
) -> None:
    heard(port, wire, b"noise")
    port.discard_input()
    assert not port.has_input()
    assert port.receive() == []
    heard(port, wire, b"answer")
    assert port.receive() == [b"answer"]


def test_bytes_before_the_port_was_opened_are_dropped(wire: SerialWire) -> None:
    first = SerialPort(wire.client)
    first.open()
    heard(first, wire, b"late")
    first.close()
    first.open()
    assert first.receive() == []
    first.close()


def test_a_missing_port_is_a_connection_error(port: SerialPort, wire: SerialWire) -> None:
    wire.unplug()
    until(port.has_input)
    with pytest.raises(ModbusConnectionError) as caught:
        port.receive()
    assert caught.value.errno == errno.EIO


def test_rts_is_set_while_it_sends(wire: SerialWire) -> None:
    """A character has 11 bits, and the delays are 20 ms each."""
    port_ = SerialPort(wire.client, baudrate=1200, rs485="rts-up", rts_delay=0.02)
    port_.open()
    port_.send([b"12345678"], 100.0)
    assert port_.resume_at == pytest.approx(100.02)
    assert wire.passed == []
    port_.go_on(100.02)
    assert port_.resume_at == pytest.approx(100.04 + 8 * 11 / 1200)
    until(lambda: wire.sent_by("client") == b"12345678")
    port_.go_on(101.0)
    assert port_.resume_at is None
    port_.close()


@pytest.fixture
def machine(tmp_path: Path) -> Path:
    """A USB adapter ttyUSB10, another without a serial number, ttyS0, ttyS1 without hardware."""
    usb = tmp_path / "sys/devices/usb1/1-2"
    tty = tmp_path / "sys/class/tty"
    tty.mkdir(parents=True)
    (tmp_path / "dev/serial/by-id").mkdir(parents=True)
    (tmp_path / "sys/bus/drivers/ftdi_sio").mkdir(parents=True)
    for name, place, files in (
        ("ttyUSB10", usb, {"idVendor": "0403", "idProduct": "6001", "serial": "A10K",
                           "manufacturer": "FTDI", "product": "USB-RS485"}),
        ("ttyUSB2", tmp_path / "sys/devices/usb1/1-3", {"idVendor": "1a86", "idProduct": "7523"}),
    ):  # fmt: skip
        (place / "1-2:1.0" / name).mkdir(parents=True)
        for file, text in files.items():
            (place / file).write_text(f"{text}\n")
        (place / "1-2:1.0" / name / "driver").symlink_to(tmp_path / "sys/bus/drivers/ftdi_sio")
        (tty / name).mkdir()
        (tty / name / "device").symlink_to(place / "1-2:1.0" / name)
        (tmp_path / "dev" / name).touch()
    for name, kind in (("ttyS0", "4"), ("ttyS1", "0")):
        (tmp_path / "sys/devices" / name).mkdir()
        (tty / name).mkdir()
        (tty / name / "type").write_text(f"{kind}\n")
        (tty / name / "device").symlink_to(tmp_path / "sys/devices" / name)
        (tmp_path / "dev" / name).touch()
    (tty / "console").mkdir()
    (tmp_path / "dev/serial/by-id/usb-FTDI_A10K").symlink_to("../../ttyUSB10")
    (tmp_path / "proc/77/fd").mkdir(parents=True)
    (tmp_path / "proc/77/comm").write_text("minicom\n")
    (tmp_path / "proc/77/fd/3").symlink_to("/dev/ttyUSB2")
    (tmp_path / "proc/78/fd").mkdir(parents=True)
    return tmp_path


def test_serial_devices_are_described_from_sysfs(machine: Path) -> None:
    assert serial_devices(str(machine)) == [
        SerialDevice("/dev/ttyS0", state="free"),
        SerialDevice(
            *("/dev/ttyUSB2", "", "ftdi_sio", "1a86", "(1a86:7523)", ""),
            state="in use by minicom (77)",
        ),
        SerialDevice(
            *("/dev/ttyUSB10", "/dev/serial/by-id/usb-FTDI_A10K", "ftdi_sio", "FTDI"),
            *("USB-RS485 (0403:6001)", "A10K", "free"),
        ),
    ]


def test_a_machine_without_serial_ports_has_an_empty_list(tmp_path: Path) -> None:
    assert serial_devices(str(tmp_path)) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_ports_that_this_user_may_not_open_are_listed(machine: Path) -> None:
    (machine / "dev/ttyS0").chmod(0)
    assert serial_devices(str(machine))[0].state == "no permission"
    (machine / "proc/78/fd").chmod(0)
    assert serial_devices(str(machine))[2].state == "not known"


def test_ports_lists_programs(machine: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setattr(ports, "serial_devices", lambda: serial_devices(str(machine)))
    process = run("ports")
    assert (process.code, process.err) == (0, "")
    assert process.out == (
        "/dev/ttyUSB2   in use by minicom (77); ftdi_sio, 1a86, (1a86:7523)\n"
        "/dev/ttyUSB10  free; ftdi_sio, FTDI, USB-RS485 (0403:6001), serial number A10K\n"
        "               /dev/serial/by-id/usb-FTDI_A10K\n"
    )
    assert run("ports", "--all").out.startswith("/dev/ttyS0     free\n")
    first, second = map(json.loads, run("ports", "--json").out.splitlines())
    assert (first["path"], second["serial_number"]) == ("/dev/ttyUSB2", "A10K")
    file = tmp_path / "ports.csv"
    assert run("ports", "--all", "--csv", file).code == 0
    assert file.read_text().count("\n") == 4
    monkeypatch.setattr(ports, "serial_devices", list)
    assert run("ports")[:2] == (1, "no serial port was found\n")
