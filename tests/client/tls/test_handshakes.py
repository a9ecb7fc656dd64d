"""Handshakes that take too long, are closed, interrupted or forked."""

import asyncio
import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from libmodbus_py import AsyncClient, Client, Device, Mapping, ModbusConnectionError, Server, State
from tests.support import certificates
from tests.support.certificates import Pki, secured
from tests.support.clients import Connect
from tests.support.peers import until
from tests.support.scripted import run as run_in_loop
from tests.support.secured import context_of
from tests.support.signals import in_child, interrupt, on_alarm
from tests.support.tls_clients import LONG, SOON, Serving, descriptors
from tests.support.tls_peers import Peer, Relay, raw


def trickles(sock: socket.socket) -> None:
    """A ServerHello without an end, byte by byte."""
    sock.recv(4096)
    for byte in b"\x16\x03\x03\x40\x00\x02\x00\x3f\xfc\x03\x03" + bytes(16_000):
        sock.sendall(bytes([byte]))
        time.sleep(0.02)


def says_hello_again_and_again(sock: socket.socket) -> None:
    """HelloRequest, which every client ignores while it shakes hands (RFC 5246, 7.4.1.1)."""
    sock.recv(4096)
    while True:
        sock.sendall(b"\x16\x03\x03\0\x04\0\0\0\0" * 1000)


def stalls(sock: socket.socket) -> None:
    while sock.recv(4096):
        pass


@pytest.mark.parametrize("talk", [trickles, says_hello_again_and_again, stalls])
def test_a_handshake_ends_with_the_timeout(connect: Connect, pki: Pki, talk) -> None:
    with raw(talk) as url:
        plc = connect(url, security=pki.client(), timeout=0.2)
        begin = time.monotonic()
        with pytest.raises(ModbusConnectionError) as caught:
            plc.read_holding_registers(0, 1)
        assert time.monotonic() - begin >= 0.19
        assert caught.value.errno is not None
        assert os.strerror(caught.value.errno) == "Connection timed out"
        plc.close()


def test_a_slow_handshake_succeeds_if_there_is_time(connect: Connect, pki: Pki, serving: Serving):
    def bytewise(data: bytes) -> Iterator[bytes]:
        for at in range(0, len(data), 7):
            time.sleep(0.0002)
            yield data[at : at + 7]

    with (
        serving() as server,
        Relay(server.port, bytewise) as relay,
        connect(relay.url, security=pki.client(), timeout=LONG) as plc,
    ):
        assert plc.read_holding_registers(5, 1) == [5]


def test_close_ends_a_handshake(connect: Connect, pki: Pki) -> None:
    event = threading.Event()

    def talk(sock: socket.socket) -> None:
        sock.recv(4096)
        event.set()
        stalls(sock)

    with raw(talk) as url:
        plc = connect(url, security=pki.client(), timeout=60)
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(plc.read_holding_registers, 0, 1)
            assert event.wait(SOON)
            plc.close()
            with pytest.raises(ModbusConnectionError, match="closed"):
                future.result(SOON)


def test_a_signal_handler_may_close_the_client_in_a_handshake(pki: Pki) -> None:
    with raw(stalls) as url:
        plc = Client(url, security=pki.client(), timeout=60)
        before = descriptors()
        with on_alarm(plc.close, 0.3), pytest.raises(ModbusConnectionError):
            plc.connect()
        until(lambda: descriptors() <= before)


def test_a_client_works_after_ctrl_c_in_the_handshake(pki: Pki, serving: Serving) -> None:
    is_silent = True
    with (
        serving() as server,
        Relay(server.port, lambda data: [] if is_silent else [data]) as relay,
        contextlib.closing(Client(relay.url, security=pki.client(), timeout=LONG)) as plc,
    ):
        with on_alarm(interrupt, 0.3), pytest.raises(KeyboardInterrupt):
            plc.connect()
        assert plc.state is State.DISCONNECTED
        is_silent = False
        assert plc.read_holding_registers(5, 1) == [5]


def test_cancelling_each_await_of_a_handshake_leaves_nothing(pki: Pki) -> None:
    """No descriptor or task is left, and a descriptor that reuses the number works."""

    def bytewise(data: bytes) -> Iterator[bytes]:
        for at in range(0, len(data), 40):
            yield data[at : at + 40]

    async def main(url: str) -> set[str]:
        security, outcomes = pki.client(), set()
        loop = asyncio.get_running_loop()
        before = descriptors()
        for turns in [*range(30), *range(30, 300, 9)]:
            plc = AsyncClient(url, security=security, timeout=LONG)
            asking = loop.create_task(plc.connect())
            for _ in range(turns):
                await asyncio.sleep(0)
            if turns % 2:
                asking.cancel()
            await plc.close()
            try:
                await asking
                outcomes.add("connected")
            except ModbusConnectionError:
                outcomes.add("failed")
            except asyncio.CancelledError:
                outcomes.add("cancelled")
            near, far = socket.socketpair()
            event = asyncio.Event()
            loop.add_reader(near, event.set)
            far.send(b"x")
            await asyncio.wait_for(event.wait(), SOON)
            loop.remove_reader(near)
            near.close()
            far.close()
        while descriptors() > before:  # the server has its own of each connection
            await asyncio.sleep(0.01)
        return outcomes

    with raw(lambda sock: _serve(pki, sock, bytewise)) as url:
        outcomes = run_in_loop(asyncio.wait_for(main(url), 60))
        assert {"failed", "cancelled"} <= outcomes


def _serve(pki: Pki, sock: socket.socket, cut: Callable[[bytes], Iterator[bytes]]) -> None:
    peer = Peer(sock, context_of(pki, certificates.server()))
    peer.cut = cut
    peer.shake_hands()
    peer.serve()


def test_a_forked_child_leaves_the_connection_alone(pki: Pki) -> None:
    """It connects anew, and says no goodbye in the parent's name."""
    server = Server(Device(Mapping(holding_registers=10)))
    with secured(server, pki) as url, Client(url, timeout=LONG) as plc:
        plc.write_register(0, 7)

        def ask_and_close() -> None:
            assert plc.read_holding_registers(0, 1) == [7]
            plc.close()

        assert in_child(ask_and_close) == 0
        assert plc.read_holding_registers(0, 1) == [7]
        assert plc.statistics.connects == 1
        assert server.statistics.handshakes == 2


def test_closing_an_asyncio_client_in_a_forked_child_leaves_the_connection_alone(pki: Pki) -> None:
    async def main(url: str) -> None:
        async with AsyncClient(url, timeout=LONG) as plc:
            await plc.write_register(0, 7)
            assert in_child(plc._driver._port.close) == 0
            assert await plc.read_holding_registers(0, 1) == [7]
            assert plc.statistics.connects == 1

    with secured(Server(Device(Mapping(holding_registers=10))), pki) as url:
        run_in_loop(main(url))
