"""
A program that uses the package as on a system without the calls of Linux: python elsewhere.py LEVEL

The level is "macos", with serial ports, or "bare", without the modules that only POSIX systems
have. It prints what works, a line for each.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import fcntl
import gc
import os
import random
import select
import selectors
import socket
import sys
import threading
import time
from collections.abc import Iterator

import pytest

LEVEL = sys.argv[1]
TAKEN = {
    os: ("eventfd", "eventfd_read", "eventfd_write", "EFD_NONBLOCK", "EFD_CLOEXEC", "pipe2"),
    select: ("epoll",),  # whose constants the selector below needs
    socket: ("TCP_QUICKACK", "TCP_KEEPIDLE", "SOCK_CLOEXEC"),
    time: ("CLOCK_BOOTTIME",),
    gc: ("freeze", "unfreeze", "get_freeze_count"),
    fcntl: ("F_DUPFD_CLOEXEC",),
    errno: ("EKEYREJECTED",),
}
ONLY_POSIX = ("resource", "fcntl", "termios", "tty", "pty")

# What is waited with in their place, as kqueue elsewhere: it has a descriptor, too.
assert selectors.DefaultSelector is selectors.EpollSelector
for module, names in TAKEN.items():
    for name in names:
        delattr(module, name)
if LEVEL == "bare":
    del os.fork, os.register_at_fork
    sys.modules.update(dict.fromkeys(ONLY_POSIX))  # type: ignore[arg-type]
sys.platform = "darwin"

from libmodbus_py import (  # noqa: E402
    AsyncClient,
    Client,
    Device,
    Gateway,
    Mapping,
    ModbusConnectionError,
    Route,
    Server,
)
from libmodbus_py.listen import listen  # noqa: E402
from libmodbus_py.page import live_page  # noqa: E402

WORDS = [555, 0, 100]


def device() -> Device:
    mapping = Mapping(holding_registers=1000)
    mapping.holding_registers[0:3] = WORDS
    return Device(mapping)


def check_blocking(url: str) -> None:
    with Client(f"{url}?keepalive=5", unit=1) as plc:
        assert plc.read_holding_registers(0, 3) == WORDS


async def check_asyncio(url: str) -> None:
    clients = [AsyncClient(url, unit=1) for _ in range(50)]
    try:
        reads = [client.read_holding_registers(0, 3) for client in clients]
        assert await asyncio.gather(*reads) == [WORDS] * len(clients)
    finally:
        for client in clients:
            await client.close()


def check_server() -> None:
    urls = ["tcp://127.0.0.1:0", "udp://127.0.0.1:0", "udp://0.0.0.0:0", "rtu+tcp://127.0.0.1:0"]
    with Server({1: device()}).background(*urls) as running:
        for url in running.urls:
            check_blocking(url.replace("0.0.0.0", "127.0.0.1"))
            asyncio.run(check_asyncio(url.replace("0.0.0.0", "127.0.0.1")))


def check_gateway() -> None:
    with Server({1: device()}).background("tcp://127.0.0.1:0") as behind:
        gateway = Gateway([Route(behind.urls[0])])
        with gateway.background("tcp://127.0.0.1:0") as running:
            check_blocking(running.urls[0])


def check_listener() -> None:
    with (
        Server({1: device()}).background("rtu+tcp://127.0.0.1:0") as behind,
        listen("rtu+tcp://127.0.0.1:0", between=behind.urls[0]) as line,
    ):
        check_blocking(line.url)
        heard = next(iter(line))
        assert heard.response is not None
        line.close()
        assert list(line) == []


def check_page() -> None:
    server = Server({1: device()})
    with live_page(server) as page, server.background("tcp://127.0.0.1:0") as running:
        check_blocking(running.urls[0])
        host, _, port = page.url.split("/")[2].partition(":")
        with socket.create_connection((host, int(port)), 10) as made:
            made.sendall(b"GET / HTTP/1.1\r\nHost: %s:%s\r\n\r\n" % (host.encode(), port.encode()))
            assert made.recv(100).startswith(b"HTTP/1.")


def check_closing() -> None:
    """A client that waits is woken from another thread, through the flag."""
    with socket.create_server(("127.0.0.1", 0)) as silent:
        plc = Client(f"tcp://127.0.0.1:{silent.getsockname()[1]}", unit=1, timeout=60)
        plc.connect()
        timer = threading.Timer(0.05, plc.close)
        timer.start()
        with contextlib.suppress(ModbusConnectionError):
            plc.read_holding_registers(0, 1)
        timer.join()


def check_children() -> None:
    """A forked child closes its copies, and asks over a connection of its own."""
    with (
        Server({1: device()}).background("tcp://127.0.0.1:0") as running,
        Client(running.urls[0], unit=1) as plc,
    ):
        assert plc.read_holding_registers(0, 3) == WORDS
        child = os.fork()
        if child == 0:
            os._exit(0 if plc.read_holding_registers(0, 3) == WORDS else 1)
        assert os.waitpid(child, 0)[1] == 0
        assert plc.read_holding_registers(0, 3) == WORDS


def check_serial() -> None:
    from libmodbus_py.tools.testing.wires import SerialWire

    with SerialWire() as wire, Server({1: device()}).background(f"rtu://{wire.server}"):
        check_blocking(f"rtu://{wire.client}")
        with pytest.raises(ModbusConnectionError, match="baudrate 12345 refused"):
            Client(f"rtu://{wire.client}?baudrate=12345", unit=1).connect()


def check_no_serial() -> None:
    with pytest.raises(ImportError, match="halted"):
        Client("rtu:///dev/ttyS0", unit=1)


def check_commands() -> None:
    """The command line starts, and reads; the calls are there again in a program of its own."""
    from libmodbus_py.cli.main import main

    with Server({1: device()}).background("tcp://127.0.0.1:0") as running:
        assert not main(["read", running.urls[0], "holding", "0", "3", "--unit", "1"])


NOT_ON = {"check_serial": "bare", "check_children": "bare", "check_no_serial": "macos"}


def checks() -> Iterator[str]:
    for name, check in list(globals().items()):
        wanted = name.startswith("check_") and name not in ("check_blocking", "check_asyncio")
        is_other = NOT_ON.get(name) == LEVEL
        if wanted and not is_other:
            check()
            yield name.removeprefix("check_")


if __name__ == "__main__":
    random.seed()
    for done in checks():
        print(done, "works", flush=True)
