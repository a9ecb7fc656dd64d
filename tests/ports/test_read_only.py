"""Serial ports that are only read: whose settings they take, and that nothing is written."""

import os
import pty
import subprocess
import sys
import termios

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.ports import serial
from libmodbus_py.ports.serial import ReadOnlySerialPort


def test_settings_are_set_and_restored() -> None:
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    before = os.open(path, os.O_RDWR | os.O_NOCTTY)
    old = termios.tcgetattr(before)
    os.close(before)
    try:
        port = ReadOnlySerialPort(path, baudrate=38400, parity="N", stop_bits=2)
        port.open()
        _, _, control, local, *speeds, _ = termios.tcgetattr(port.descriptor)
        assert speeds == [termios.B38400] * 2
        assert control & termios.CSTOPB
        assert not local & (termios.ICANON | termios.ECHO)
        with pytest.raises(RuntimeError, match="only read"):
            port.send([b"x"], 0.0)
        port.close()
        after = os.open(path, os.O_RDWR | os.O_NOCTTY)
        assert termios.tcgetattr(after)[:6] == old[:6]
        os.close(after)
    finally:
        os.close(master)


def test_settings_of_another_program_stay() -> None:
    master, slave = pty.openpty()
    try:
        before = termios.tcgetattr(slave)
        port = ReadOnlySerialPort(os.ttyname(slave), baudrate=38400)
        port.open()
        assert termios.tcgetattr(slave) == before
        port.close()
        assert termios.tcgetattr(slave) == before
    finally:
        os.close(master)
        os.close(slave)


def test_settings_of_a_program_in_another_namespace_are_kept(caplog) -> None:
    """A process with the port open in another namespace."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    before = termios.tcgetattr(slave)
    holding = f"f = open({path!r}, 'rb', 0); print('x', flush=True); import time; time.sleep(60)"
    other = subprocess.Popen([sys.executable, "-c", holding], stdout=subprocess.PIPE)
    try:
        assert other.stdout is not None
        other.stdout.readline()
        os.close(slave)
        port = ReadOnlySerialPort(path, baudrate=38400)
        port.open()
        assert f"({other.pid})" in caplog.text
        assert termios.tcgetattr(port.descriptor)[4:6] == before[4:6]
        port.close()
    finally:
        other.kill()
        other.communicate()
        os.close(master)


def test_a_port_that_has_its_settings_already_opens_without_parity() -> None:
    """glibc's tcsetattr calls that an error."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    for _ in range(2):
        port = ReadOnlySerialPort(path, baudrate=38400, parity="E")
        port.open()
        assert termios.tcgetattr(port.descriptor)[4:6] == [termios.B38400] * 2
        port._restored = None  # as if the program had died
        port.close()
    os.close(master)


def test_a_setting_that_the_driver_changes_is_refused(monkeypatch) -> None:
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    monkeypatch.setattr(serial, "PSEUDO_TERMINALS", ())
    with pytest.raises(ModbusConnectionError, match="parity E refused: the port has N"):
        ReadOnlySerialPort(path, parity="E").open()
    monkeypatch.setattr(serial, "_baudrate_of", lambda descriptor: 9600)
    with pytest.raises(ModbusConnectionError, match="baudrate 230400 refused: the port does 9600"):
        ReadOnlySerialPort(path, parity="N", baudrate=230_400).open()
    os.close(master)


@pytest.mark.parametrize("baudrate", [9600, 12345])
def test_bytes_are_read_at_any_baud_rate(baudrate: int) -> None:
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.close(slave)
    port = ReadOnlySerialPort(path, baudrate=baudrate, parity="N")
    port.open()
    try:
        assert port.receive() == []
        os.write(master, b"\x01\n\x03\x04\r\x11")
        assert b"".join(port.receive()) == b"\x01\n\x03\x04\r\x11"
        os.close(master)
        with pytest.raises(ModbusConnectionError):
            port.receive()
    finally:
        port.close()
        port.close()
    assert port.descriptor == -1
