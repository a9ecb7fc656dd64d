"""
The blocking client over UDP: datagrams that are lost, late, doubled, damaged or another's.
"""

from __future__ import annotations

import errno
import gc
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Self

import pytest

from libmodbus_py import (
    Context,
    Device,
    IllegalDataAddress,
    InvalidResponse,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
    pdu,
)
from libmodbus_py.client.blocking import UdpContext
from tests.support.clients import Connect
from tests.support.fake import echo, mbap
from tests.support.pace import LATE

# A request -> the datagrams to answer; None closes the port.
Answer = Callable[[bytes], list[bytes] | None]


class FakeUdpServer:
    """
    Answers each datagram as told.

    Args:
        answers: one for each request, in order; the last one goes on.
        family: AF_INET or AF_INET6, on the loopback address.
    """

    def __init__(self, *answers: Answer, family: int = socket.AF_INET) -> None:
        self._answers = list(answers)
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.bind(("::1" if family == socket.AF_INET6 else "127.0.0.1", 0))
        self._closing = threading.Lock()
        self._is_closed = False  # by an answer, while the test may already end
        self.port: int = self._socket.getsockname()[1]
        host = "[::1]" if family == socket.AF_INET6 else "127.0.0.1"
        self.url = f"udp://{host}:{self.port}"
        self.requests: list[bytes] = []
        self.client: Any = None
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._closing, socket.socket(self._socket.family, socket.SOCK_DGRAM) as last:
            if not self._is_closed:
                last.sendto(b"", self._socket.getsockname())
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while True:
            request, client = self._socket.recvfrom(600)
            if not request:
                return
            self.client = client
            self.requests.append(request)
            answer = self._answers[0]
            if len(self._answers) > 1:
                del self._answers[0]
            datagrams = answer(request)
            if datagrams is None:
                with self._closing:
                    self._is_closed = True
                    self._socket.close()
                return
            for datagram in datagrams:
                self._socket.sendto(datagram, client)


def good(request: bytes) -> list[bytes]:
    return [echo(request)]


def silent(request: bytes) -> list[bytes]:
    return []


def reads(count: int) -> list[pdu.Request[Any]]:
    return [pdu.ReadHoldingRegisters(address, 1) for address in range(count)]


@pytest.fixture
def refused_port() -> Iterator[int]:
    """Where nobody listens, and nobody else will: its socket hears another one only."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as made:
        made.bind(("127.0.0.1", 0))
        made.connect(made.getsockname())
        yield int(made.getsockname()[1])


# --- what is asked for comes back ----------------------------------------------------------


@pytest.fixture
def context(connect: Connect, device: Device) -> Iterator[Any]:
    with (
        Server({17: device}).background("udp://127.0.0.1:0") as running,
        connect(running.urls[0], unit=17) as made,
    ):
        yield made


def test_tables_and_files_of_our_server(context: Any, mapping: Mapping) -> None:
    assert context.read_coils(10, 3) == [True, False, True]
    assert context.read_input_registers(200, 100)[:3] == [2000, 2001, 2002]
    context.write_registers(110, [1, 2, 65535])
    assert mapping.holding_registers[110:113] == [1, 2, 65535]
    assert context.read_file_records([(4, 1, 2)]) == [[1, 2]]
    with pytest.raises(IllegalDataAddress) as caught:
        context.read_holding_registers(0, 1)
    assert caught.value.sent[6:] == bytes.fromhex("11 03 0000 0001")
    assert caught.value.received[6:] == bytes.fromhex("11 83 02")


def test_many_requests_to_our_server(context: Any) -> None:
    asked = [pdu.ReadHoldingRegisters(100 + at % 10, 1) for at in range(200)]
    assert context.execute_many(asked) == [[1000 + at % 10] for at in range(200)]
    assert context.read_many({"a": ("holding_registers", 100, 2), "b": ("coils", 10)}) == {
        "a": [1000, 1001],
        "b": [True],
    }


def test_url_with_an_ipv6_address(connect: Connect) -> None:
    with (
        FakeUdpServer(good, family=socket.AF_INET6) as server,
        connect(server.url, unit=3) as context,
    ):
        assert context.read_holding_registers(5, 1) == [5]
        assert server.requests[0][2:] == bytes.fromhex("0000 0006 03 03 0005 0001")


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: UdpContext(""), "host"),
        (lambda: UdpContext("127.0.0.1", 0), "port"),
        (lambda: UdpContext("127.0.0.1", unit=256), "unit"),
        (lambda: UdpContext("127.0.0.1", timeout=0), "timeout"),
        (lambda: UdpContext("127.0.0.1", busy_retries=-1), "busy_retries"),
        (lambda: Context.from_url("udp://"), "host"),
    ],
)
def test_bad_argument_is_named(make: Callable[[], object], named: str) -> None:
    with pytest.raises((TypeError, ValueError), match=named):
        make()


# --- datagrams that do not fit -------------------------------------------------------------


def test_lost_request_times_out_and_its_late_answer_reaches_nobody(connect: Connect) -> None:
    late: list[bytes] = []

    def held(request: bytes) -> list[bytes]:
        late.append(echo(request))
        return []

    def all_at_once(request: bytes) -> list[bytes]:
        return [*late, echo(request)]

    with (
        FakeUdpServer(good, held, all_at_once, good) as server,
        connect(server.url, timeout=0.2) as context,
    ):
        assert context.read_holding_registers(1, 1) == [1]
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError) as caught:
            context.read_holding_registers(2, 1)
        assert 0.2 <= time.monotonic() - start < 0.2 + LATE
        assert caught.value.sent == server.requests[1]
        assert context.read_holding_registers(3, 1) == [3]
        assert context.read_holding_registers(4, 1) == [4]
        assert context.late_answers == 1


def test_doubled_answer_reaches_nobody(connect: Connect) -> None:
    with (
        FakeUdpServer(lambda request: good(request) * 3) as server,
        connect(server.url) as context,
    ):
        for address in range(20):
            assert context.read_holding_registers(address, 1) == [address]
        assert context.execute_many(reads(50)) == [[address] for address in range(50)]


def damaged(request: bytes) -> list[bytes]:
    answer = echo(request)
    return [
        b"",
        b"\0",
        answer[:-1],
        answer + b"\0",
        answer + answer,
        echo(request, protocol=1),
        echo(request, length=999),
        echo(request, transaction=0x7777),
        bytes(1500),
    ]


def test_damaged_datagrams_do_not_end_the_wait(connect: Connect) -> None:
    with (
        FakeUdpServer(lambda request: [*damaged(request), echo(request)]) as server,
        connect(server.url) as context,
    ):
        for address in range(10):
            assert context.read_holding_registers(address, 1) == [address]
        assert context.execute_many(reads(50)) == [[address] for address in range(50)]


def test_damaged_datagrams_are_no_answer(connect: Connect) -> None:
    with (
        FakeUdpServer(damaged) as server,
        connect(server.url, timeout=0.2) as context,
    ):
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError, match="no complete answer") as caught:
            context.read_holding_registers(1, 1)
        assert 0.2 <= time.monotonic() - start < 0.2 + LATE
        assert echo(server.requests[0])[:-1] in caught.value.received
        with pytest.raises(ModbusTimeoutError):
            context.execute_many(reads(4))


def test_flood_of_datagrams_does_not_extend_the_timeout(connect: Connect) -> None:
    stop = threading.Event()

    def flood(request: bytes) -> list[bytes]:
        while not stop.is_set():
            server._socket.sendto(echo(request, transaction=0x7777), server.client)
        return []

    with (
        FakeUdpServer(flood) as server,
        connect(server.url, timeout=0.2) as context,
    ):
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError):
            context.read_holding_registers(1, 1)
        assert time.monotonic() - start < 0.2 + LATE
        with pytest.raises(ModbusTimeoutError):
            context.read_holding_registers(1, 1)
        with pytest.raises(ModbusTimeoutError):
            context.execute_many(reads(4))
        assert time.monotonic() - start < 0.6 + LATE
        stop.set()


def test_datagram_of_another_host_is_never_seen(connect: Connect) -> None:
    def spoofed(request: bytes) -> list[bytes]:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            stranger.sendto(echo(request)[:-1] + b"\xff", server.client)
        return good(request)

    with (
        FakeUdpServer(spoofed) as server,
        connect(server.url) as context,
    ):
        for address in range(10):
            assert context.read_holding_registers(address, 1) == [address]
        assert context.late_answers == 0


@pytest.mark.parametrize(
    "answer",
    [
        lambda request: [echo(request, unit=9)],
        lambda request: [mbap(request, b"\x04\x02\0\0")],
        lambda request: [mbap(request, b"\x03\x04\0\0\0\0")],
    ],
)
def test_frame_that_does_not_answer_is_invalid(connect: Connect, answer: Answer) -> None:
    with (
        FakeUdpServer(answer, answer, good) as server,
        connect(server.url) as context,
    ):
        with pytest.raises(InvalidResponse) as caught:
            context.read_holding_registers(1, 1)
        assert caught.value.received
        with pytest.raises(InvalidResponse):
            context.execute_many([*reads(1), *reads(1)])
        assert context.read_holding_registers(1, 1) == [1]


# --- many in flight ------------------------------------------------------------------------


def test_many_in_flight_lose_some_and_get_the_others_in_any_order(connect: Connect) -> None:
    waiting: list[bytes] = []

    def four_at_a_time(request: bytes) -> list[bytes]:
        waiting.append(request)
        if len(waiting) < 4:
            return []
        answers = [echo(each) for each in reversed(waiting) if each[9] not in (5, 30)]
        waiting.clear()
        return answers

    with (
        FakeUdpServer(four_at_a_time) as server,
        connect(server.url, timeout=0.5) as context,
    ):
        found = context.execute_many(reads(40), return_exceptions=True)
        assert [at for at, each in enumerate(found) if isinstance(each, ModbusError)] == [5, 30]
        assert isinstance(found[5], ModbusTimeoutError)
        assert all(found[at] == [at] for at in range(40) if at not in (5, 30))
        assert len(server.requests) == 40


def test_answers_that_came_before_the_port_closed_are_kept(connect: Connect) -> None:
    def last_words(request: bytes) -> list[bytes] | None:
        if len(server.requests) < 16:
            return []
        for each in server.requests[:8]:
            server._socket.sendto(echo(each), server.client)
        return None

    with (
        FakeUdpServer(last_words) as server,
        connect(server.url) as context,
    ):
        found = context.execute_many(reads(60), return_exceptions=True)
        assert found[0] == [0]
        for at, each in enumerate(found):
            if at >= 8 or each != [at]:  # the news may come before an answer is read
                assert isinstance(each, ModbusConnectionError)
                assert each.errno == errno.ECONNREFUSED


# --- the port ------------------------------------------------------------------------------


def test_port_where_nobody_listens_is_a_connection_error_at_once(
    connect: Connect, refused_port: int
) -> None:
    with connect(f"udp://127.0.0.1:{refused_port}", timeout=5) as context:
        start = time.monotonic()
        for _ in range(3):
            with pytest.raises(ModbusConnectionError) as caught:
                context.read_coils(0, 1)
            assert caught.value.errno == errno.ECONNREFUSED
        found = context.execute_many(reads(800), return_exceptions=True)
        assert {each.errno for each in found} == {errno.ECONNREFUSED}
        assert time.monotonic() - start < LATE


def test_port_that_comes_back_is_used_again(connect: Connect) -> None:
    with FakeUdpServer(good) as server, connect(server.url) as context:
        assert context.read_holding_registers(1, 1) == [1]
        port = server.port
        server.__exit__()
        with pytest.raises(ModbusConnectionError):
            context.read_holding_registers(1, 1)
        server._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        server._socket.bind(("127.0.0.1", port))
        server._thread = threading.Thread(target=server._serve)
        server._thread.start()
        assert context.read_holding_registers(2, 1) == [2]


@pytest.mark.parametrize("host", ["no-such-host.invalid", "x" * 300])
def test_name_that_does_not_resolve(connect: Connect, host: str) -> None:
    with pytest.raises(ModbusConnectionError, match="cannot resolve host") as caught:
        connect(f"udp://{host}").read_coils(0, 1)
    assert caught.value.__cause__ is not None


def test_no_descriptor_is_left_behind(connect: Connect, refused_port: int) -> None:
    def use(port: int) -> None:
        with connect(f"udp://127.0.0.1:{port}") as context:
            context.read_holding_registers(1, 1)
        UdpContext("127.0.0.1", port).read_holding_registers(1, 1)  # forgotten, not closed
        with pytest.raises(ModbusConnectionError):
            connect(f"udp://127.0.0.1:{refused_port}").read_coils(0, 1)
        gc.collect()

    with FakeUdpServer(good) as server:
        use(server.port)
        before = len(os.listdir("/proc/self/fd"))
        for _ in range(20):
            use(server.port)
        assert len(os.listdir("/proc/self/fd")) <= before
