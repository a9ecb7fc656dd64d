"""Devices that connect to the client, as modems behind a mobile network do."""

import asyncio
import gc
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    Device,
    FrameError,
    Gateway,
    Mapping,
    ModbusConnectionError,
    ModbusTimeoutError,
    Route,
    Server,
    State,
)
from libmodbus_py.ports.endpoint import parse_to_listen
from tests.support.cases import each_case
from tests.support.clients import ALL, asking
from tests.support.commands import run
from tests.support.driver import rtu
from tests.support.peers import until
from tests.support.signals import in_child

IMEI = b"865123456789012"
HEARTBEAT = b"www.usr.cn"


@pytest.fixture
def port() -> int:
    """A port that is free on 127.0.0.1."""
    with socket.create_server(("127.0.0.1", 0)) as bound:
        number: int = bound.getsockname()[1]
        return number


def answer(request: bytes, scheme: str) -> bytes:
    """Answer a read of one register with its address."""
    if scheme == "listen+tcp":
        return request[:4] + bytes([0, 5, request[6], 3, 2]) + request[8:10]
    return rtu(f"{request[0]:02x} 03 02 {request[2:4].hex()}")


class Modem:
    """Connects to a client, greets it, and answers; `heartbeats` come before and after answers."""

    def __init__(self, port: int, scheme: str = "listen+tcp", greeting: bytes = b"") -> None:
        self.heartbeat = b""
        self.before_answer: Callable[[], object] = bool
        self.is_silent = False
        self.requests: list[bytes] = []
        self._scheme = scheme
        self._socket = until(lambda: self._connected(port))
        self._socket.sendall(greeting)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _connected(self, port: int) -> socket.socket | None:
        try:
            return socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            return None

    def _serve(self) -> None:
        try:
            while request := self._socket.recv(300):
                self.requests.append(request)
                self.before_answer()
                if not self.is_silent:
                    data = answer(request, self._scheme)
                    self._socket.sendall(self.heartbeat + data + self.heartbeat)
        except OSError:
            pass

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def is_closed(self) -> bool:
        return not self._thread.is_alive()

    def close(self) -> None:
        """Hang up; may be called repeatedly."""
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        self._thread.join()
        self._socket.close()


@contextmanager
def dialling(port: int, *arguments: Any) -> Iterator[list[Modem]]:
    """Let a modem connect as soon as the client listens."""
    modems: list[Modem] = []
    thread = threading.Thread(target=lambda: modems.append(Modem(port, *arguments)))
    thread.start()
    try:
        yield modems
    finally:
        thread.join()
        for device in modems:
            device.close()


@ALL
@pytest.mark.parametrize("scheme", ["listen+tcp", "listen+rtu+tcp"])
def test_a_client_waits_for_its_device_and_drops_other_bytes(kind: str, scheme, port: int):
    url = f"{scheme}://127.0.0.1:{port}?greeting=20%20bytes,www.usr.cn"
    greeting = b"89860012345678901234"
    with dialling(port, scheme, greeting) as modems, asking(kind, url, timeout=10) as plc:
        assert [plc.read_holding_registers(address, 1) for address in (7, 8)] == [[7], [8]]
        modem = until(lambda: modems)[0]  # the modem's thread adds it after connecting
        modem.heartbeat = HEARTBEAT
        for address in range(20):
            modem.send(HEARTBEAT)
            assert plc.read_holding_registers(address, 1) == [address]
        assert plc.statistics.connects == 1
    with socket.create_server(("127.0.0.1", port)):  # the address is free again
        pass


@ALL
def test_a_new_connection_replaces_the_one_before(kind: str, port: int) -> None:
    url = f"listen+tcp://127.0.0.1:{port}"
    with dialling(port) as modems, asking(kind, url, timeout=10) as plc:
        assert plc.read_holding_registers(1, 1) == [1]
        with closing(Modem(port)), closing(Modem(port)) as last:
            time.sleep(0.05)  # until the system has both connections
            assert plc.read_holding_registers(2, 1) == [2]
            assert len(last.requests) == 1
            until(until(lambda: modems)[0].is_closed)
            assert plc.read_holding_registers(3, 1) == [3]
            assert plc.statistics.connects == 2


@ALL
def test_a_device_that_closed_its_connection_may_connect_again(kind: str, port: int) -> None:
    url = f"listen+tcp://127.0.0.1:{port}"
    with dialling(port) as modems, asking(kind, url, timeout=10) as plc:
        until(lambda: modems)[0].close()
        for address in range(3):
            with dialling(port):
                assert plc.read_holding_registers(address, 1) == [address]


@ALL
def test_a_request_in_flight_times_out_and_the_next_one_is_answered(kind: str, port: int):
    url = f"listen+tcp://127.0.0.1:{port}"
    with dialling(port) as modems, asking(kind, url, timeout=0.3) as plc:
        until(lambda: modems)[0].is_silent = True
        with pytest.raises(ModbusTimeoutError):
            plc.read_holding_registers(1, 1)
        with closing(Modem(port)):
            time.sleep(0.05)
            assert plc.read_holding_registers(2, 1) == [2]


@ALL
def test_without_a_device_requests_fail_as_without_a_connection(kind: str, port: int) -> None:
    url = f"listen+tcp://127.0.0.1:{port}"
    with dialling(port) as modems, asking(kind, url, timeout=0.2) as plc:
        until(lambda: modems)[0].close()
        for _ in range(2):  # at once: clients that wait for a device do not pause
            start = time.monotonic()
            with pytest.raises(ModbusConnectionError, match=r"no (device|connection)"):
                plc.read_holding_registers(1, 1)
            assert 0.1 < time.monotonic() - start < 5
        with closing(Modem(port)):
            assert plc.read_holding_registers(2, 1) == [2]


@ALL
def test_a_second_client_at_one_address_is_refused(kind: str, port: int) -> None:
    url = f"listen+tcp://127.0.0.1:{port}"
    with dialling(port), asking(kind, url, timeout=10) as plc:
        with (
            pytest.raises(ModbusConnectionError, match=f"cannot listen at 127.0.0.1:{port}: Addr"),
            asking(kind, url),
        ):
            pass
        assert plc.read_holding_registers(1, 1) == [1]


@ALL
def test_what_comes_before_the_first_request_is_dropped_and_later_a_likely_mistake(
    kind: str, port: int
) -> None:
    url = f"listen+tcp://127.0.0.1:{port}?connect_delay=0.1"
    with dialling(port, "listen+tcp", IMEI) as modems, asking(kind, url, timeout=10) as plc:
        assert plc.read_holding_registers(1, 1) == [1]
        until(lambda: modems)[0].heartbeat = IMEI
        with pytest.raises(FrameError, match=r"a registration packet or heartbeat\? see greeting"):
            plc.read_holding_registers(1, 1)


@ALL
def test_an_answer_to_a_request_before_the_device_connected_again_is_accepted(kind: str, port: int):
    url = f"listen+tcp://127.0.0.1:{port}"
    with dialling(port) as modems, asking(kind, url, timeout=10) as plc:
        until(lambda: modems)[0].before_answer = lambda: modems.append(Modem(port))
        assert plc.read_holding_registers(1, 1) == [1]
        assert plc.read_holding_registers(2, 1) == [2]
        assert [len(modem.requests) for modem in modems] == [1, 1]


def test_a_client_that_is_closed_while_it_waits_frees_its_address(port: int) -> None:
    plc = Client(f"listen+tcp://127.0.0.1:{port}", timeout=600)
    failures: list[BaseException] = []

    def ask() -> None:
        try:
            plc.connect()
        except ModbusConnectionError as error:
            failures.append(error)

    thread = threading.Thread(target=ask)
    thread.start()
    until(lambda: plc.state is State.CONNECTING)
    plc.close()
    thread.join()
    assert "this client is closed" in str(failures[0])
    with socket.create_server(("127.0.0.1", port)):
        pass


def test_a_cancelled_wait_leaves_the_address_to_the_next_request(port: int) -> None:
    async def use() -> None:
        async with asyncio.timeout(20):
            plc = AsyncClient(f"listen+tcp://127.0.0.1:{port}", timeout=600)
            task = asyncio.create_task(plc.read_holding_registers(1, 1))
            await asyncio.sleep(0.05)
            task.cancel()
            await asyncio.wait([task])
            with dialling(port):
                assert await plc.read_holding_registers(2, 1) == [2]
            task = asyncio.create_task(plc.read_holding_registers(1, 1))
            await asyncio.sleep(0.05)
            await plc.close()
            with pytest.raises(ModbusConnectionError, match="this client is closed"):
                await task

    asyncio.run(use())
    with socket.create_server(("127.0.0.1", port)):
        pass


def test_a_forked_child_leaves_the_address_to_its_parent(port: int) -> None:
    with dialling(port), Client(f"listen+tcp://127.0.0.1:{port}", timeout=10) as plc:

        def use() -> None:
            with pytest.raises(ModbusConnectionError, match="cannot listen"):
                plc.read_holding_registers(1, 1)
            plc.close()

        assert in_child(use) == 0
        assert plc.read_holding_registers(1, 1) == [1]
    with socket.create_server(("127.0.0.1", port)):
        pass


def test_a_collected_client_frees_its_address(port: int) -> None:
    with dialling(port):
        plc = Client(f"listen+tcp://127.0.0.1:{port}", timeout=10)
        assert plc.read_holding_registers(1, 1) == [1]
        del plc
        gc.collect()
        with socket.create_server(("127.0.0.1", port)):
            pass


def test_a_gateway_reaches_a_device_that_connects(port: int) -> None:
    route = Route(f"listen+tcp://127.0.0.1:{port}?timeout=10")
    with (
        Gateway([route]).background("tcp://127.0.0.1:0") as gateway,
        dialling(port),
        Client(gateway.urls[0], timeout=10) as plc,
    ):
        assert plc.read_holding_registers(7, 1) == [7]


def test_the_command_line_reaches_a_device_that_connects(port: int) -> None:
    with dialling(port, "listen+rtu+tcp", IMEI):
        url = f"listen+rtu+tcp://127.0.0.1:{port}"
        process = run("read", url, "hr", "7", "--timeout", "10", "--greeting", IMEI.decode())
    assert (process.code, process.err) == (0, "")
    assert process.out.split() == ["7", "7"]


FLEET = """
[[device]]
name = "meter"
map = "meter.csv"
interval = 10
url = "listen+tcp://127.0.0.1:{port}?timeout=10&greeting={greeting}"
"""


def test_a_fleet_polls_a_device_that_connects(port: int, tmp_path: Path) -> None:
    (tmp_path / "meter.csv").write_text("name,table,address,type\npower,hr,7,uint16\n")
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET.format(port=port, greeting=IMEI.decode()))
    with dialling(port, "listen+tcp", IMEI):
        process = run("poll", str(file), "--once", "--csv", str(tmp_path / "readings.csv"))
    assert process.code == 0, process.err
    assert "meter,power,7," in (tmp_path / "readings.csv").read_text()


@each_case(
    ("url", "options", "text"),
    [
        ("listen+tcp://plc.example:1502", {}, "must be an address of this machine"),
        ("listen+tcp://0.0.0.0:1502", {"source": "127.0.0.1"}, "source is for hosts"),
        ("listen+tcp://0.0.0.0:1502", {"greeting": ""}, "greeting must be such as"),
        ("tcp://0.0.0.0:1502", {"greeting": "x"}, "greeting is for listen\\+tcp://, not for tcp"),
    ],
)
def test_options_that_do_not_apply_to_listening_are_refused(url: str, options: Any, text: str):
    with pytest.raises(ValueError, match=text):
        Client(url, **options)


def test_a_server_does_not_wait_for_a_device() -> None:
    with pytest.raises(ValueError, match="this is for clients, whose device connects"):
        parse_to_listen("listen+tcp://0.0.0.0:1502")
    server = Server(Device(Mapping(1)))
    with (
        pytest.raises(ValueError, match="this is for clients"),
        server.background("listen+tcp://127.0.0.1:1502"),
    ):
        pass
