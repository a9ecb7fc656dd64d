"""
The serial ports of this machine, what the system knows of them, and the programs that use them.
"""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

# Types of linux/serial_core.h: PORT_UNKNOWN, of ports that a kernel lists although no hardware
# stands behind them; and PORT_16550A, which divides its clock by 16 and a whole number.
NO_HARDWARE = "0"
PLAIN_UART = "4"


@dataclass(frozen=True)
class SerialDevice:
    """A serial port, as the system describes it; empty where it says nothing."""

    path: str
    stable_path: str = ""  # in /dev/serial/by-id, where names do not change with numbers
    driver: str = ""
    vendor: str = ""  # this and the next two are of a USB device, in words or as hexadecimal ids
    product: str = ""
    serial_number: str = ""
    state: str = "not known"  # not found out, because opening the port would move its lines


def serial_devices(root: str = "/") -> list[SerialDevice]:
    """Return the serial ports of this machine, sorted by path."""
    base = Path(root)
    uses, sees_all = open_devices(base)
    users = {user.path: user for user in uses}
    links = sorted((base / "dev/serial/by-id").glob("*"))
    stable = {_target(link): f"/dev/serial/by-id/{link.name}" for link in links}
    devices = []
    for place in sorted((base / "sys/class/tty").glob("*"), key=_in_order):
        if not (place / "device").exists() or lacks_hardware(place.name, root):
            continue
        path = f"/dev/{place.name}"
        node = base / "dev" / place.name
        devices.append(
            SerialDevice(
                path,
                stable.get(place.name, ""),
                _target(place / "device/driver"),
                *_usb(place / "device"),
                state=_state(node, users.get(path), sees_all),
            )
        )
    return devices


def lacks_hardware(path: str, root: str = "/") -> bool:
    """Return True for a port that the kernel lists without hardware, so that no call succeeds."""
    return _text(_class(path, root) / "type") == NO_HARDWARE


def highest_rate(path: str) -> int:
    """Return the highest baud rate of a 16550A; 0 for other hardware, of which it is not known."""
    place = _class(path, "/")
    clock = _text(place / "uartclk")
    return int(clock) // 16 if clock.isdigit() and _text(place / "type") == PLAIN_UART else 0


def _class(path: str, root: str) -> Path:
    return Path(root) / "sys/class/tty" / Path(os.path.realpath(path)).name


def _in_order(place: Path) -> tuple[str, int]:
    name = place.name.rstrip("0123456789")
    number = place.name.removeprefix(name)
    return name, int(number or -1)


def _target(link: Path) -> str:
    try:
        return Path(os.readlink(link)).name
    except OSError:
        return ""


def _usb(device: Path) -> tuple[str, str, str]:
    """Return vendor, product and serial number; the ids are in a folder above the interface."""
    real = Path(os.path.realpath(device))
    for folder in (real, *real.parents[:5]):
        if vendor := _text(folder / "idVendor"):
            product = _text(folder / "idProduct")
            return (
                _text(folder / "manufacturer") or vendor,
                f"{_text(folder / 'product')} ({vendor}:{product})".strip(),
                _text(folder / "serial"),
            )
    return "", "", ""


def _text(file: Path) -> str:
    try:
        return file.read_text("utf-8", "backslashreplace").strip()
    except OSError:
        return ""


class OpenDevice(NamedTuple):
    """A file in /dev that a process has open with a descriptor."""

    path: str
    process: int
    descriptor: int
    program: str  # name and process, such as "minicom (77)"


def open_devices(base: Path = Path("/")) -> tuple[list[OpenDevice], bool]:
    """Return the files in /dev that programs have open, and True if all programs were seen."""
    files: list[OpenDevice] = []
    sees_all = True
    for process in base.glob("proc/[0-9]*"):
        program = f"{_text(process / 'comm') or 'a program'} ({process.name})"
        try:
            for link in (process / "fd").iterdir():
                with contextlib.suppress(FileNotFoundError):  # the descriptor was closed meanwhile
                    if (path := os.readlink(link)).startswith("/dev/"):
                        files.append(OpenDevice(path, int(process.name), int(link.name), program))
        except PermissionError:
            sees_all = False
        except OSError:  # the process has ended meanwhile
            continue
    return files, sees_all


def users_of(device: str) -> list[OpenDevice]:
    """Return the programs that have a port open, as far as this user may know."""
    path = os.path.realpath(device)
    return [user for user in open_devices()[0] if user.path == path and _is_here(user)]


def _is_here(user: OpenDevice) -> bool:
    """Return False for a pseudo-terminal of a container, where names may be as here."""
    with contextlib.suppress(OSError):
        here, theirs = os.stat(user.path), os.stat(f"/proc/{user.process}/fd/{user.descriptor}")
        return not user.path.startswith("/dev/pts/") or here.st_dev == theirs.st_dev
    return True


def other_programs(device: str) -> str:
    """Return the names of the other programs that have a port open."""
    names = [user.program for user in users_of(device) if user.process != os.getpid()]
    return ", ".join(dict.fromkeys(names)) or "another program"


def other_user(device: str, descriptor: int) -> str | None:
    """Return another program that has a port open, or this one with another descriptor."""
    own = os.getpid()
    for user in users_of(device):
        if (user.process, user.descriptor) != (own, descriptor):
            return "this program" if user.process == own else user.program
    return None


def _state(node: Path, user: OpenDevice | None, sees_all: bool) -> str:
    if user is not None:
        return f"in use by {user.program}"
    if not os.access(node, os.R_OK | os.W_OK):
        return "no permission" if node.exists() else "no device file"
    return "free" if sees_all else "not known"
