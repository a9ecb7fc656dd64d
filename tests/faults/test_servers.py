"""Servers, while the n-th call of the system fails: whoever asks afterwards is answered."""

import contextlib
import os
import select
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Client, Device, Mapping, ModbusError, Server
from libmodbus_py.protocol import framing
from libmodbus_py.tools.testing.wires import open_line
from tests.faults.injecting import Scenario, Trial, eventually, try_faults
from tests.support.certificates import Pki

PART = ("server", "ports", "device", "security")

TCP_REQUEST = bytes.fromhex("0001 0000 0006 01 03 0005 0001")
TCP_ANSWER = bytes.fromhex("0001 0000 0005 01 03 02 0005")


def on_line(body: bytes) -> bytes:
    return body + framing.crc16(body).to_bytes(2, "little")


LINE_REQUEST, LINE_ANSWER = on_line(TCP_REQUEST[6:]), on_line(TCP_ANSWER[6:])

# How long somebody waits whose answer a fault took away.
SHORT = 0.05

Ask = Callable[[str], bytes]


def server() -> Server:
    """Return a server whose registers hold their addresses."""
    mapping = Mapping(holding_registers=10)
    mapping.holding_registers[:] = range(10)
    return Server({1: Device(mapping)})


def port_of(url: str) -> tuple[str, int]:
    host, _, port = url.rpartition("/")[2].rpartition(":")
    return host, int(port)


def over(kind: socket.SocketKind) -> Ask:
    def ask(url: str) -> bytes:
        with contextlib.suppress(OSError), socket.socket(socket.AF_INET, kind) as client:
            client.settimeout(SHORT)
            client.connect(port_of(url))
            client.send(TCP_REQUEST)
            return client.recv(300)
        return b""

    return ask


def on_far_end(far: int) -> Ask:
    def ask(url: str) -> bytes:
        with contextlib.suppress(BlockingIOError):
            os.read(far, 300)
        os.write(far, LINE_REQUEST)
        ready, _, _ = select.select([far], [], [], SHORT)
        return os.read(far, 300) if ready else b""

    return ask


def secured(pki: Pki) -> Ask:
    def ask(url: str) -> bytes:
        with (
            contextlib.suppress(ModbusError),
            Client(url, security=pki.client(), timeout=1) as client,
        ):
            return TCP_ANSWER if client.read_holding_registers(5, 1) == [5] else b"wrong"
        return b""

    return ask


def ask_while_failing(
    trial: Trial, background: AbstractContextManager[Any], ask: Ask, answer: bytes
) -> None:
    """Begin to serve and end it while calls fail; in between, a request must be answered."""
    with contextlib.ExitStack() as stack:
        running = None
        with trial.faults(RuntimeError):
            running = stack.enter_context(background)
            ask(running.urls[0])
            ask(running.urls[0])
        if running is not None:
            assert eventually(lambda: ask(running.urls[0]) == answer)
        with trial.faults():
            stack.close()


def serving(url: str, ask: Ask, answer: bytes, make: Callable[[], Server] = server) -> Scenario:
    """Serve in a thread, and ask while calls fail and when they do not any more."""

    def scenario(trial: Trial) -> None:
        ask_while_failing(trial, make().background(url), ask, answer)
        with make().background(url) as again:  # no socket keeps the address
            assert again.urls

    return scenario


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for the next attempt."""
    monkeypatch.setattr("libmodbus_py.server.serial.REOPEN_AFTER", 0.001)
    monkeypatch.setattr("libmodbus_py.server.peers.RETRY_AFTER", 0.001)


def test_a_tcp_server_continues_after_errors_of_the_system() -> None:
    try_faults(serving("tcp://127.0.0.1:0", over(socket.SOCK_STREAM), TCP_ANSWER), *PART)


def test_a_udp_server_continues_after_errors_of_the_system() -> None:
    try_faults(serving("udp://127.0.0.1:0", over(socket.SOCK_DGRAM), TCP_ANSWER), *PART)


@pytest.fixture
def line() -> Iterator[tuple[int, str]]:
    """The far end of a line, and the path of the near one."""
    far, near, path = open_line()
    yield far, path
    os.close(far)
    os.close(near)


def test_a_serial_server_continues_after_errors_of_the_system(line: tuple[int, str]) -> None:
    far, path = line
    try_faults(serving(f"rtu://{path}?baudrate=115200", on_far_end(far), LINE_ANSWER), *PART)


def test_a_tls_server_continues_after_errors_of_the_system(tmp_path: Path) -> None:
    pki = Pki(tmp_path)

    def make() -> Server:
        return Server(server().devices, security=pki.server())

    ask = secured(pki)
    try_faults(serving("tls://127.0.0.1:0", ask, TCP_ANSWER, make), "server", errors=1)
