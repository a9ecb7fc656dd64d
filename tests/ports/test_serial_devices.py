"""
The serial ports of a machine, described by files as the kernel has them.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest

from libmodbus_py.cli.find import ports
from libmodbus_py.ports.serial_devices import SerialDevice, serial_devices
from tests.support.commands import run


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


def test_what_the_system_knows(machine: Path) -> None:
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


def test_a_machine_without_any(tmp_path: Path) -> None:
    assert serial_devices(str(tmp_path)) == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may open everything")
def test_ports_that_this_user_may_not_open(machine: Path) -> None:
    (machine / "dev/ttyS0").chmod(0)
    assert serial_devices(str(machine))[0].state == "no permission"
    (machine / "proc/78/fd").chmod(0)
    assert serial_devices(str(machine))[2].state == "not known"


def test_the_command(machine: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(ports, "serial_devices", lambda: serial_devices(str(machine)))
    done = run("ports")
    assert (done.code, done.err) == (0, "")
    assert done.out == (
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
