"""
Faults that were found by attacking the clients, each by what it looked like to a caller.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator

import pytest
from asking import ALL, BLOCKING, answer, asking
from fake import FakeServer, FakeUnit, mbap
from scripted import run as run_watched

from libmodbus_py import (
    AsyncClient,
    ModbusError,
    ModbusTimeoutError,
    framing,
)

# Of a machine that is busy with other tests; what is measured on one that is not, is below 0.05.
LATE = 0.25


def rtu(request: bytes) -> bytes:
    return answer(request, "rtu")


# --- answers that come twice, late, or after something else ---------------------------------


@ALL
def test_a_unit_that_answers_twice_gives_no_wrong_values(kind: str) -> None:
    def twice(request: bytes) -> Iterator[bytes]:
        yield rtu(request)
        time.sleep(0.001)
        yield rtu(request)

    with FakeUnit(twice) as unit, asking(kind, f"rtu://{unit.path}?baudrate=19200") as client:
        assert [client.read(address) for address in range(50)] == list(range(50))


STRAYS: dict[str, Callable[[bytes], bytes]] = {
    "00": lambda request: b"\x00",
    "FF": lambda request: b"\xff",
    "FE 00": lambda request: b"\xfe\x00",
    "unit": lambda request: answer(request, "rtu", unit=9),
    "echo": lambda request: request,
    "00 and echo": lambda request: b"\x00" + request,
}


@ALL
@pytest.mark.parametrize("pause", [0, 0.03])
@pytest.mark.parametrize("stray", STRAYS)
def test_what_stands_before_each_answer_on_a_line_harms_none(
    stray: str, pause: float, kind: str
) -> None:
    """A transceiver that turns round makes bytes; a pause is longer than the framer's silence."""

    def strayed(request: bytes) -> Iterator[bytes]:
        yield STRAYS[stray](request) + (b"" if pause else rtu(request))
        if pause:
            time.sleep(pause)
            yield rtu(request)

    with FakeUnit(strayed) as unit, asking(kind, f"rtu://{unit.path}?baudrate=115200") as client:
        assert [client.read(address) for address in range(40)] == list(range(40))


@ALL
def test_echoes_of_writes_are_their_answers_or_harm_none(kind: str) -> None:
    def echoed(request: bytes) -> list[bytes]:
        return [request, request[:6] + framing.crc16(request[:6]).to_bytes(2, "little")]

    with FakeUnit(echoed) as unit, asking(kind, f"rtu://{unit.path}?baudrate=115200") as client:
        for address in range(20):
            client.write_register(address, 1)
            client.write_registers(address, [1, 2])


@ALL
def test_an_answer_with_another_id_before_each_answer_harms_none(kind: str) -> None:
    def with_other(request: bytes) -> list[bytes]:
        other = mbap(
            request, b"\x03\x02\xff\xff", transaction=int.from_bytes(request[:2], "big") ^ 0x5555
        )
        return [other + answer(request, "tcp")]

    with FakeServer(with_other) as server, asking(kind, f"tcp://127.0.0.1:{server.port}") as client:
        assert [client.read(address) for address in range(40)] == list(range(40))
        assert server.connections == 1


@ALL
def test_a_late_answer_during_a_request_does_not_fail_it(kind: str) -> None:
    """The answer to a request that was given up comes while the next one waits."""

    class Late:
        owed = b""

        def __call__(self, request: bytes) -> Iterator[bytes]:
            owed, self.owed = self.owed, b""
            address = int.from_bytes(request[8:10], "big")
            if address == 7:
                self.owed = answer(request, "tcp")
                return
            time.sleep(0.02)
            yield owed
            time.sleep(0.02)
            yield answer(request, "tcp")

    url = "tcp://127.0.0.1:{}"
    with FakeServer(Late()) as server, asking(kind, url.format(server.port)) as client:
        for _ in range(3):
            assert client.read(1) == 1
            client.client.timeout = 0.05
            with pytest.raises(ModbusTimeoutError):
                client.read(7)
            client.client.timeout = 1
            assert client.read(2) == 2
        assert client.client.late_answers == 3
        assert server.connections == 1


# --- floods --------------------------------------------------------------------------------


class Flood:
    """A server that sends without end, from the first request on."""

    def __init__(self, data: bytes, udp: bool = False) -> None:
        self._data = data
        self._udp = udp

    def __enter__(self) -> Flood:
        kind = socket.SOCK_DGRAM if self._udp else socket.SOCK_STREAM
        self._socket = socket.socket(socket.AF_INET, kind)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self.port = self._socket.getsockname()[1]
        if not self._udp:
            self._socket.listen()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(OSError):
                if self._udp:
                    _, peer = self._socket.recvfrom(300)
                    while not self._over.is_set():
                        self._socket.sendto(self._data, peer)
                else:
                    peer, _ = self._socket.accept()
                    with peer:
                        peer.settimeout(5)
                        peer.recv(300)
                        while not self._over.is_set():
                            peer.sendall(self._data)


FLOODS: dict[str, tuple[str, bytes]] = {
    "digits": ("ascii+tcp", b"0123456789ABCDEF" * 4096),
    "colons and digits": ("ascii+tcp", (b":" + b"0123456789ABCDEF" * 100) * 40),
    "frames with other ids": ("tcp", bytes.fromhex("FFFF0000000501030200AA") * 4096),
    "headers of another protocol": ("tcp", bytes.fromhex("800100070005010302000A") * 4096),
    "datagrams": ("udp", bytes.fromhex("FFFF0000000501030200AA")),
    "large datagrams": ("udp", bytes(60_000)),
    "noise": ("rtu+tcp", os.urandom(65536)),
    "starts of frames": ("rtu+tcp", b"\x01\x03\xfa" * 20_000),
    "frames of another unit": ("rtu+tcp", bytes.fromhex("09030200AAD9FB") * 8192),
}


@ALL
@pytest.mark.parametrize("flood", FLOODS)
def test_a_flood_costs_neither_time_nor_memory(flood: str, kind: str) -> None:
    scheme, data = FLOODS[flood]
    with Flood(data, scheme == "udp") as server:
        url = f"{scheme}://127.0.0.1:{server.port}"
        with asking(kind, url, timeout=0.3) as client:
            tracemalloc.start()
            try:
                for silence in (0.0, 0.0 if scheme in ("tcp", "udp") else 0.3):
                    start = time.monotonic()
                    with pytest.raises(ModbusError) as caught:
                        client.read(1)
                    assert time.monotonic() - start < silence + 0.3 + LATE
                    assert len(caught.value.received) <= 600
                    assert len(str(caught.value)) < 300
                kept, most = tracemalloc.get_traced_memory()
            finally:
                tracemalloc.stop()
    # What is looked at in one turn, and more than that is not kept; datagrams come by dozens.
    assert kept < 256 * 1024
    assert most < (8 << 20 if scheme == "udp" else 512 * 1024)


FLOODER = """
import os, sys, time
while True:
    os.write(int(sys.argv[1]), bytes.fromhex(sys.argv[2]))
    time.sleep(float(sys.argv[3]))
"""


@contextlib.contextmanager
def noisy_line(noise: bytes, pause: float) -> Iterator[str]:
    """A serial line on which another process writes without end."""
    with FakeUnit(lambda request: []) as unit:
        fd = unit._master
        command = [sys.executable, "-c", FLOODER, str(fd), noise.hex(), str(pause)]
        with subprocess.Popen(command, pass_fds=[fd]) as process:
            try:
                yield unit.path
            finally:
                process.kill()


@ALL
@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
@pytest.mark.parametrize("pause", [0, 0.001, 0.02])
def test_a_line_that_is_never_quiet_ends_the_wait(pause: float, scheme: str, kind: str) -> None:
    """From the first request on, and while it waits for the silence that must come before."""
    noise = b"0123456789ABCDEF" if scheme == "ascii" else bytes(range(0x80, 0x90))
    with (
        noisy_line(noise, pause) as path,
        asking(kind, f"{scheme}://{path}?baudrate=115200", timeout=0.2) as client,
    ):
        for _ in range(3):
            start = time.monotonic()
            with pytest.raises(ModbusError) as caught:
                client.read(1)
            assert time.monotonic() - start < 2 * 0.2 + LATE
            assert len(caught.value.received) <= 600
            assert len(str(caught.value)) < 300


# --- connections that died, and are being made -----------------------------------------------


@contextlib.contextmanager
def dumb_after(first: int) -> Iterator[int]:
    """A server whose first connection goes dumb after so many answers; the others are good."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        over = threading.Event()
        numbers = iter(range(100))

        def serve(peer: socket.socket, most: float) -> None:
            with peer, contextlib.suppress(OSError):
                while request := peer.recv(12):
                    if most > 0:
                        peer.sendall(answer(request, "tcp"))
                    most -= 1

        def accept() -> None:
            with contextlib.suppress(OSError):
                while not over.is_set():
                    peer, _ = listener.accept()
                    most = first if next(numbers) == 0 else 1e9
                    threading.Thread(target=serve, args=(peer, most), daemon=True).start()

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield listener.getsockname()[1]
        over.set()
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_a_dead_connection_is_left_though_the_caller_has_less_patience() -> None:
    async def main(port: int) -> None:
        async with AsyncClient(f"tcp://127.0.0.1:{port}", timeout=1) as client:
            assert await client.read_holding_registers(1, 1) == [1]
            failed = 0
            for address in range(20):
                try:
                    async with asyncio.timeout(0.2):
                        assert await client.read_holding_registers(address, 1) == [address]
                except TimeoutError:
                    failed += 1
            assert failed == 3
            assert client.statistics.connects == 2

    with dumb_after(1) as port:
        run_watched(main(port))


@BLOCKING
def test_a_dead_connection_is_left_by_a_context(kind: str) -> None:
    with (
        dumb_after(1) as port,
        asking(kind, f"tcp://127.0.0.1:{port}", timeout=0.1) as client,
    ):
        assert client.read(1) == 1
        for _ in range(3):
            with pytest.raises(ModbusTimeoutError):
                client.read(2)
        assert client.read(3) == 3
