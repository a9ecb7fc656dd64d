"""
A network and a /dev of their own, in which documents run as they are printed.

`isolate` gives them to the calling process, which must have one thread, and to all that it starts:
nobody else takes their ports, of which everybody may open those below 1024; 192.0.2.10 is an
address of this machine; and what `plug_in` is given are its serial ports.
"""

import contextlib
import ctypes
import fcntl
import os
import signal
import socket
import struct
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

# linux/sched.h, linux/mount.h, linux/sockios.h, linux/if.h
CLONE_NEWNS, CLONE_NEWUSER, CLONE_NEWNET = 0x20000, 0x1000_0000, 0x4000_0000
MS_BIND, MS_REC, MS_PRIVATE = 0x1000, 0x4000, 0x40000
SIOCSIFFLAGS, SIOCSIFADDR = 0x8914, 0x8916
IFF_UP = 1
PR_SET_PDEATHSIG = 1  # linux/prctl.h

ADDRESSES = {"lo": "127.0.0.1", "lo:1": "192.0.2.10"}
DEVICES = ("null", "zero", "full", "random", "urandom", "tty")

_libc = ctypes.CDLL(None, use_errno=True)


def isolate() -> None:
    """
    Leave the network, the mounts and, because only root may leave these, the users of this machine.

    Raises:
        PermissionError: the system does not allow it; some containers do not.
    """
    user, group = os.getuid(), os.getgid()
    _call(_libc.unshare(CLONE_NEWUSER | CLONE_NEWNET | CLONE_NEWNS))
    for name, text in (
        ("setgroups", "deny"),
        ("uid_map", f"{user} {user} 1"),
        ("gid_map", f"{group} {group} 1"),
    ):
        Path("/proc/self", name).write_text(text)
    _make_network()
    _make_devices()
    _libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)  # else it would survive a killed test run


def _call(result: int) -> None:
    if result:
        error = ctypes.get_errno()
        raise OSError(error, os.strerror(error))


def _make_network() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for name, address in ADDRESSES.items():
            label, number = name.encode(), socket.inet_aton(address)
            ip = struct.pack("16sHH4s8x", label, socket.AF_INET, 0, number)
            fcntl.ioctl(any_socket, SIOCSIFADDR, ip)
            fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sH14x", label, IFF_UP))
    Path("/proc/sys/net/ipv4/ip_unprivileged_port_start").write_text("0")


def _make_devices() -> None:
    """Mount a /dev with the devices that every program needs, and its own pseudo-terminals."""
    _mount("none", "/", "", MS_REC | MS_PRIVATE)  # later mounts are seen by this process only
    with tempfile.TemporaryDirectory() as before:
        _mount("/dev", before, "", MS_BIND | MS_REC)
        # Nobody may create, as `> /dev/null` does, what is there in a folder that all may write to.
        _mount("tmpfs", "/dev", "tmpfs", 0, "mode=755")
        for name in DEVICES:
            Path("/dev", name).touch()
            _mount(f"{before}/{name}", f"/dev/{name}", "", MS_BIND)
        _call(_libc.umount2(before.encode(), 2))  # MNT_DETACH
    for name in ("pts", "shm"):
        Path("/dev", name).mkdir()
    _mount("devpts", "/dev/pts", "devpts", 0, "newinstance,ptmxmode=0666")
    Path("/dev/ptmx").symlink_to("pts/ptmx")
    for name, target in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        Path("/dev", name).symlink_to(f"/proc/self/fd{target}")


def _mount(source: str, target: str, kind: str, flags: int = 0, options: str = "") -> None:
    texts = [text.encode() for text in (source, target, kind)]
    _call(_libc.mount(*texts, ctypes.c_ulong(flags), options.encode()))


@contextlib.contextmanager
def plug_in(ports: Mapping[str, str]) -> Iterator[None]:
    """Make serial ports available: a name in /dev, and the device that it stands for."""
    for name, path in ports.items():
        Path(name).symlink_to(path)
    try:
        yield
    finally:
        for name in ports:
            Path(name).unlink()
