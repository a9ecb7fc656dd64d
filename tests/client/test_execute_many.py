"""
Many requests in flight on one connection: order, limits, and all that may go wrong.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import select
import signal
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Self

import pytest

from libmodbus_py import (
    Context,
    FrameError,
    IllegalDataAddress,
    InvalidResponse,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    ServerDeviceBusy,
    TcpContext,
    pdu,
)
from tests.support.c_programs import SOURCES, compile_c
from tests.support.clients import Connect
from tests.support.fake import FakeServer, FakeUnit, dead, echo, mbap
from tests.support.interop import program
from tests.support.pace import LATE

UNIT = 17


class Peer:
    """One connection of a client, seen by a test that plays the server."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._received = b""

    def read(self) -> bytes:
        """One request, header included; EOFError at the end."""
        while len(self._received) < 6 or len(self._received) < self._size:
            data = self._connection.recv(65536)
            if not data:
                raise EOFError
            self._received += data
        adu, self._received = self._received[: self._size], self._received[self._size :]
        return adu

    def read_all(self, quiet: float = 0.05) -> list[bytes]:
        """Requests until none comes for a while."""
        found = [self.read()]
        while self._received or select.select([self._connection], [], [], quiet)[0]:
            found.append(self.read())
        return found

    def send(self, *adus: bytes) -> None:
        self._connection.sendall(b"".join(adus))

    @property
    def _size(self) -> int:
        size: int = struct.unpack(">H", self._received[4:6])[0]
        return 6 + size


class Played:
    """
    A TCP server that takes one connection after the other.

    Args:
        play: is given each connection and its number, from 0; it ends when that returns.
    """

    def __init__(self, play: Callable[[Peer, int], object]) -> None:
        self._play = play
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.connections = 0
        self._now: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        with contextlib.suppress(OSError, AttributeError):
            self._now.shutdown(socket.SHUT_RDWR)  # type: ignore[union-attr]
        self._thread.join()
        self._listener.close()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                self._now = connection
                self.connections += 1
                with connection, contextlib.suppress(EOFError, OSError):
                    self._play(Peer(connection), self.connections - 1)


def address_of(request: bytes) -> int:
    return int.from_bytes(request[8:10], "big")


def refusal(request: bytes, code: int) -> bytes:
    return mbap(request, bytes([0x83, code]))


def good(peer: Peer, number: int = 0) -> None:
    while True:
        peer.send(echo(peer.read()))


def reads(count: int, first: int = 0) -> list[pdu.Request[Any]]:
    return [pdu.ReadHoldingRegisters(address, 1) for address in range(first, first + count)]


def echoes(count: int, first: int = 0) -> list[list[int]]:
    return [[address] for address in range(first, first + count)]


Talking = Callable[..., contextlib.AbstractContextManager[tuple[Any, "Played"]]]


@pytest.fixture
def talking_to(connect: Connect) -> Talking:
    """A client of each kind, and the server it talks to."""

    @contextlib.contextmanager
    def made(play: Callable[[Peer, int], object], **options: Any) -> Iterator[tuple[Any, Played]]:
        with (
            Played(play) as server,
            connect(f"tcp://127.0.0.1:{server.port}", **options) as client,
        ):
            yield client, server

    return made


# --- what is asked for comes back ----------------------------------------------------------


@pytest.mark.parametrize("max_in_flight", [1, 2, 16])
def test_results_have_the_order_of_requests_on_every_transport(
    connect: Connect, url: str, mapping: Mapping, max_in_flight: int
) -> None:
    asked = [
        pdu.WriteRegisters(150, (7, 8, 9)),
        pdu.ReadCoils(10, 3),
        *(pdu.ReadHoldingRegisters(100 + at, 1) for at in range(10)),
        pdu.ReadFileRecords([(4, 1, 2)]),  # type: ignore[arg-type]
        pdu.ReadInputRegisters(200, 2),
    ]
    expected = [None, [True, False, True], *echoes(10, 1000), [[1, 2]], [2000, 2001]]
    with connect(url, unit=UNIT) as context:
        for _ in range(2):
            assert context.execute_many(asked, max_in_flight=max_in_flight) == expected
            assert context.read_holding_registers(150, 3) == [7, 8, 9]
    assert mapping.holding_registers[150:153] == [7, 8, 9]


def test_refusals_stand_in_their_places_on_every_transport(connect: Connect, url: str) -> None:
    asked = [pdu.ReadCoils(10, 1), pdu.ReadHoldingRegisters(0, 1), pdu.ReadCoils(11, 1)]
    with connect(url, unit=UNIT) as context:
        first, refused, last = context.execute_many(asked, return_exceptions=True)
        assert (first, last) == ([True], [False])
        assert isinstance(refused, IllegalDataAddress)
        assert (refused.unit, refused.function) == (UNIT, 3)
        assert refused.asked == "ReadHoldingRegisters(address=0, count=1)"
        assert refused.sent
        assert refused.received
        with pytest.raises(IllegalDataAddress, match="address=0, count=1"):
            context.execute_many(asked)


def test_libmodbus_server_in_c(connect: Connect, tmp_path: Path) -> None:
    server = compile_c(SOURCES / "server.c", tmp_path / "server")
    asked = [pdu.ReadHoldingRegisters(100 + at % 100, 125) for at in range(800)]
    with program(server, "tcp", 0) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().split()[1])
        with connect(f"tcp://127.0.0.1:{port}", unit=UNIT, timeout=10) as context:
            found = context.execute_many(asked)
    assert found == [list(range(1100 + at % 100, 1225 + at % 100)) for at in range(800)]


@pytest.mark.parametrize("size", [1, 2, 5, 300])
def test_answers_may_come_in_any_pieces(talking_to: Talking, size: int) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            answers = b"".join(echo(each) for each in peer.read_all(0.01))
            for at in range(0, len(answers), size):
                peer.send(answers[at : at + size])

    with talking_to(play) as (context, _):
        assert context.execute_many(reads(40)) == echoes(40)


def test_answers_may_come_in_any_order(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            peer.send(*(echo(each) for each in reversed(peer.read_all())))

    with talking_to(play) as (context, server):
        assert context.execute_many(reads(50)) == echoes(50)
        assert (context.late_answers, server.connections) == (0, 1)


def test_nothing_to_ask_needs_no_connection(connect: Connect) -> None:
    context = connect("tcp://127.0.0.1:1")
    assert context.execute_many([]) == []
    assert context.read_many({}) == {}


# --- how many are in flight ----------------------------------------------------------------


@pytest.mark.parametrize("limit", [1, 2, 3, 16, 100, 256])
def test_as_many_are_in_flight_as_allowed_and_no_more(talking_to: Talking, limit: int) -> None:
    waiting: list[int] = []

    def play(peer: Peer, number: int) -> None:
        held: list[bytes] = []
        while True:
            held += peer.read_all()
            waiting.append(len(held))
            peer.send(*(echo(held.pop(0)) for _ in range(min(3, limit, len(held)))))
            if len(waiting) == 3:  # enough was seen
                peer.send(*map(echo, held))
                good(peer)

    with talking_to(play, timeout=5, max_in_flight=256) as (context, _):
        count = 2 * limit + 10
        assert context.execute_many(reads(count), max_in_flight=limit) == echoes(count)
    assert waiting == [limit] * 3


def test_a_request_that_nobody_answers_makes_them_go_one_by_one(talking_to: Talking) -> None:
    most = 0

    def play(peer: Peer, number: int) -> None:
        nonlocal most
        while True:
            got = peer.read_all(0.01)
            most = max(most, len(got))
            peer.send(*(echo(each) for each in got if each[7] == 3))

    listen_only = pdu.Diagnostics(pdu.SubFunction.FORCE_LISTEN_ONLY, b"\0\0")
    with talking_to(play, turnaround=0) as (context, _):
        found = context.execute_many([*reads(2), listen_only, *reads(2)], return_exceptions=True)
    assert found == [[0], [1], None, [0], [1]]
    assert most <= 2


# --- arguments -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("requests", "options", "kind", "named"),
    [
        (None, {}, TypeError, "requests must be a list"),
        ([*reads(3), "read"], {}, TypeError, r"requests\[3\] must be one of pdu, not str"),
        ([pdu.ReadCoils], {}, TypeError, r"requests\[0\] must be one of pdu"),
        (reads(1), {"max_in_flight": 0}, ValueError, "max_in_flight must be in 1..256"),
        (reads(1), {"max_in_flight": 257}, ValueError, "max_in_flight must be in 1..256"),
        (reads(1), {"max_in_flight": True}, TypeError, "max_in_flight"),
        (reads(1), {"max_in_flight": "16"}, TypeError, "max_in_flight"),
    ],
)
def test_nothing_is_sent_for_bad_arguments(
    connect: Connect, requests: Any, options: Any, kind: type[Exception], named: str
) -> None:
    with FakeServer(lambda each: [echo(each)]) as server:
        with connect(server.url) as context:
            with pytest.raises(kind, match=named):
                context.execute_many(requests, **options)
            assert context.read_holding_registers(5, 1) == [5]
        assert len(server.requests) == 1


def test_broadcast_of_a_read_is_refused_before_the_writes_go_out(connect: Connect) -> None:
    with FakeUnit() as unit, connect(f"rtu://{unit.path}", unit=0, turnaround=0) as everyone:
        with pytest.raises(ValueError, match=r"requests\[1\]: unit 0 is a broadcast"):
            everyone.execute_many([pdu.WriteRegister(1, 2), pdu.ReadCoils(0, 1)])
        assert unit.requests == []


# --- no answer, and answers that come late ---------------------------------------------------


def test_request_without_an_answer_times_out_alone(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            if address_of(request) not in (3, 20):
                peer.send(echo(request))

    with talking_to(play, timeout=0.3, unit=9) as (context, server):
        start = time.monotonic()
        found = context.execute_many(reads(40), return_exceptions=True)
        assert 0.1 <= time.monotonic() - start < 0.3 + LATE
        silent = [found[3], found[20]]
        found[3], found[20] = [3], [20]
        assert found == echoes(40)
        for error, address in zip(silent, (3, 20), strict=True):
            assert isinstance(error, ModbusTimeoutError)
            assert (error.unit, error.function, error.received) == (9, 3, b"")
            assert error.asked == f"ReadHoldingRegisters(address={address}, count=1)"
            assert error.sent[6:] == bytes([9, 3, 0, address, 0, 1])
        assert server.connections == 1
        with pytest.raises(ModbusTimeoutError, match="address=3"):
            context.execute_many(reads(40))


def test_timeout_counts_from_when_a_request_is_sent(talking_to: Talking) -> None:
    """All of them take many times as long as one may."""

    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            time.sleep(0.01)
            peer.send(echo(request))

    with talking_to(play, timeout=0.3) as (context, _):
        assert context.execute_many(reads(50), max_in_flight=4) == echoes(50)


def test_trickle_does_not_extend_the_timeout(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        answer = echo(peer.read())
        for byte in answer:
            peer.send(bytes([byte]))
            time.sleep(0.15)

    with talking_to(play, timeout=0.2) as (context, _):
        start = time.monotonic()
        with pytest.raises(ModbusTimeoutError):
            context.execute_many(reads(3))
        assert time.monotonic() - start < 0.6 + LATE


def test_late_answers_reach_nobody(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        late = []
        while True:
            request = peer.read()
            if address_of(request) in (5, 6):
                late.append(echo(request))
            elif address_of(request) >= 100:
                peer.send(*late, echo(request))
                late = []
            else:
                peer.send(echo(request))

    with talking_to(play, timeout=0.3) as (context, server):
        assert context.read_holding_registers(1, 1) == [1]
        found = context.execute_many(reads(20), return_exceptions=True)
        assert [at for at, each in enumerate(found) if isinstance(each, ModbusError)] == [5, 6]
        assert context.late_answers == 0
        assert context.read_holding_registers(100, 1) == [100]
        for address in range(101, 105):
            assert context.read_holding_registers(address, 1) == [address]
        assert (context.late_answers, server.connections) == (2, 1)
        found = context.execute_many([*reads(10), *reads(10, 100)], return_exceptions=True)
        assert [at for at, each in enumerate(found) if isinstance(each, ModbusError)] == []
        assert (context.late_answers, server.connections) == (2, 1)


@pytest.mark.parametrize("again", ["one", "many"])
def test_requests_left_behind_by_a_failure_poison_nothing(talking_to: Talking, again: str) -> None:
    """The first is refused; the other fifteen are answered when something else is asked."""
    left = 0

    def play(peer: Peer, number: int) -> None:
        nonlocal left
        good_until_refused(peer)
        held = peer.read_all()
        left = len(held)
        peer.send(refusal(held.pop(0), 2))
        fresh = peer.read_all()
        peer.send(echo(held.pop()), *map(echo, fresh), *map(echo, reversed(held)))
        good(peer)

    def good_until_refused(peer: Peer) -> None:
        for _ in range(2):
            peer.send(echo(peer.read()))

    with talking_to(play) as (context, server):
        for _ in range(2):
            assert context.read_holding_registers(1, 1) == [1]
        with pytest.raises(IllegalDataAddress):
            context.execute_many(reads(400))
        assert left == 16  # and nothing was sent after the refusal
        if again == "one":
            assert context.read_holding_registers(900, 1) == [900]
        else:
            assert context.execute_many(reads(10, 900)) == echoes(10, 900)
        for address in range(500, 520):
            assert context.read_holding_registers(address, 1) == [address]
        assert (context.late_answers, server.connections) == (15, 1)


@pytest.mark.parametrize("silent", [(3, 9), ()])
def test_half_a_frame_poisons_nothing(talking_to: Talking, silent: tuple[int, ...]) -> None:
    """Half a late answer, or half a frame that nobody asked for; the rest comes with the next."""

    def play(peer: Peer, number: int) -> None:
        rest = b""
        while True:
            request = peer.read()
            address = address_of(request)
            answer = b"" if address in silent else rest + echo(request)
            rest = rest if address in silent else b""
            if address == (3 if silent else 8):
                held = echo(request) if silent else echo(request, transaction=1)
            if address == 9 and number == 0:
                answer, rest = answer + held[:8], held[8:]
            peer.send(answer)

    with talking_to(play, timeout=0.2) as (context, _):
        for _ in range(2):
            assert context.read_holding_registers(1, 1) == [1]
        found = context.execute_many(reads(10), max_in_flight=2, return_exceptions=True)
        assert [at for at, each in enumerate(found) if isinstance(each, ModbusError)] == [*silent]
        for address in range(20, 30):
            assert context.read_holding_registers(address, 1) == [address]


def test_flood_of_answers_does_not_hold_up_the_next_batch(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        while number:
            peer.send(echo(peer.read()))
        flood = echo(peer.read()) * 5000
        while True:
            peer.send(flood)

    with talking_to(play, timeout=0.3) as (context, _):
        start = time.monotonic()
        assert context.execute_many(reads(1)) == [[0]]
        with contextlib.suppress(ModbusTimeoutError):
            assert context.execute_many(reads(20)) == echoes(20)
        assert time.monotonic() - start < LATE


@pytest.mark.alone
@pytest.mark.parametrize("timeout", [20, 3])
def test_id_is_not_given_again_while_its_answer_may_come(
    talking_to: Talking, timeout: float
) -> None:
    """There are 16384 ids, and the first answer comes after 17000 others."""
    same: list[int] = []

    def play(peer: Peer, number: int) -> None:
        held = peer.read()
        while True:
            request = peer.read()
            if request[:2] == held[:2]:
                same.append(address_of(request))
            if timeout == 3 and address_of(request) % 4000 == 0:  # each within it, all not
                time.sleep(0.9)
            if address_of(request) == 17_000:
                peer.send(echo(held))
            peer.send(echo(request))

    with talking_to(play, timeout=timeout) as (context, _):
        first, *found = context.execute_many(reads(17_001), return_exceptions=True)
        assert found == echoes(17_000, 1)
        assert not same
        if timeout == 20:
            assert first == [0]
        else:
            assert isinstance(first, ModbusTimeoutError)
            assert context.late_answers == 1


def test_unanswered_requests_among_answered_ones_leave_the_connection(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            if address_of(request) % 4 == 0:
                peer.send(echo(request))

    with talking_to(play, timeout=0.2, max_in_flight=256) as (context, server):
        for _ in range(7):
            found = context.execute_many(reads(256), max_in_flight=256, return_exceptions=True)
            assert sum(isinstance(each, ModbusTimeoutError) for each in found) == 192
        assert server.connections == 1


@pytest.mark.alone
def test_three_timeouts_in_a_row_make_a_new_connection(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        if number < 2:
            while True:
                peer.read()
        good(peer)

    with talking_to(play, timeout=0.5) as (context, server):
        found = context.execute_many(reads(20), max_in_flight=4, return_exceptions=True)
        # Between two that time out another may still be sent to where nobody answers.
        assert [type(each) for each in found[:8]] == [ModbusTimeoutError] * 8
        assert found[14:] == echoes(6, 14)
        assert server.connections == 3


# --- bad answers ---------------------------------------------------------------------------


def test_first_failure_in_the_order_of_requests_is_raised(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        requests = peer.read_all()
        peer.send(refusal(requests[5], 4), *(echo(each) for each in requests[6:]))
        time.sleep(0.05)
        peer.send(*(echo(each) for each in requests[3:5]), refusal(requests[1], 2))
        peer.send(echo(requests[0]), mbap(requests[2], b"\x04\x02\0\0"))
        good(peer)

    with talking_to(play) as (context, _):
        with pytest.raises(IllegalDataAddress, match="address=1,") as caught:
            context.execute_many(reads(30))
        assert caught.value.received[6:] == b"\x01\x83\x02"
        assert context.execute_many(reads(30)) == echoes(30)


def test_failure_is_raised_without_waiting_for_what_comes_after_it(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        requests = peer.read_all()
        peer.send(echo(requests[0]), *(refusal(requests[at], 2) for at in (1, 5)))
        good(peer)

    with talking_to(play, timeout=20) as (context, _):
        start = time.monotonic()
        with pytest.raises(IllegalDataAddress, match="address=1,"):
            context.execute_many(reads(30))
        assert time.monotonic() - start < LATE
        assert context.execute_many(reads(30)) == echoes(30)


def test_after_a_wrong_unit_the_next_answer_is_looked_at(talking_to: Talking) -> None:
    """libmodbus, which carries requests otherwise, does not check the unit."""
    wrong = False

    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            peer.send(echo(request, unit=99 if wrong else 1))

    with talking_to(play) as (context, _):
        for _ in range(2):
            assert context.read_holding_registers(1, 1) == [1]
        wrong = True
        with pytest.raises(InvalidResponse):
            context.execute_many(reads(2))
        with pytest.raises(InvalidResponse):
            context.read_holding_registers(1, 1)


def test_wrong_answers_spoil_their_own_requests_only(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            answers = {
                3: mbap(request, b"\x04\x02" + request[8:10]),
                5: echo(request, unit=99),
                7: mbap(request, b"\x03\x04" + request[8:12]),
                9: refusal(request, 77),
            }
            stranger = echo(request, transaction=1)
            peer.send(stranger, answers.get(address_of(request), echo(request)))

    with talking_to(play) as (context, server):
        found = context.execute_many(reads(12), return_exceptions=True)
        for at in (3, 5, 7):
            assert isinstance(found[at], InvalidResponse)
            assert found[at].asked == f"ReadHoldingRegisters(address={at}, count=1)"
            assert found[at].received
        assert "unit 99 answered" in str(found[5])
        assert found[9].code == 77
        rest = [at for at in range(12) if at not in (3, 5, 7, 9)]
        assert [found[at] for at in rest] == [[at] for at in rest]
        assert (context.late_answers, server.connections) == (12, 1)


def test_stream_that_cannot_be_understood_fails_all_in_flight(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        for _ in range(4 if number == 0 else 100):
            peer.send(echo(peer.read()))
        requests = peer.read_all()
        peer.send(echo(requests[0]), echo(requests[1], length=999))
        peer.read()

    with talking_to(play) as (context, server):
        found = context.execute_many(reads(40), max_in_flight=4, return_exceptions=True)
        failed = [at for at, each in enumerate(found) if isinstance(each, FrameError)]
        assert failed == [5, 6, 7]
        assert all(
            found[at].asked.startswith(f"ReadHoldingRegisters(address={at},") for at in failed
        )
        assert [each for at, each in enumerate(found) if at not in failed] == [
            [at] for at in range(40) if at not in failed
        ]
        assert server.connections == 2


def test_frame_of_another_protocol_is_skipped_and_costs_its_own_request_alone(
    talking_to: Talking,
) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            address = address_of(request)
            peer.send(echo(request, protocol=1)) if address in (5, 6) else None
            peer.send(echo(request)) if address != 5 else None

    with talking_to(play, timeout=0.3) as (context, server):
        found = context.execute_many(reads(40), max_in_flight=4, return_exceptions=True)
        assert isinstance(found[5], FrameError)
        assert "protocol 1" in str(found[5])
        assert [each for at, each in enumerate(found) if at != 5] == [
            [at] for at in range(40) if at != 5
        ]
        assert server.connections == 1


# --- connections that end --------------------------------------------------------------------


def closing_after(count: int) -> Callable[[Peer, int], None]:
    def play(peer: Peer, number: int) -> None:
        for _ in range(count):
            peer.send(echo(peer.read()))
        peer.read_all()

    return play


def test_lost_connection_raises_for_the_first_without_an_answer(talking_to: Talking) -> None:
    with talking_to(closing_after(7)) as (context, server):
        with pytest.raises(ModbusConnectionError, match="address=7,") as caught:
            context.execute_many(reads(30))
        assert caught.value.errno == errno.ECONNRESET
        assert server.connections == 1
        assert context.execute_many(reads(5)) == echoes(5)
        assert server.connections == 2


def test_lost_connection_fails_what_was_in_flight_and_the_rest_goes_on(talking_to: Talking) -> None:
    with talking_to(closing_after(10)) as (context, server):
        found = context.execute_many(reads(40), max_in_flight=4, return_exceptions=True)
        lost = [at for at, each in enumerate(found) if isinstance(each, ModbusConnectionError)]
        assert lost == [10, 11, 12, 13, 24, 25, 26, 27, 38, 39]
        assert len({id(found[at]) for at in lost}) == len(lost)
        for at in lost:
            assert found[at].asked == f"ReadHoldingRegisters(address={at}, count=1)"
            assert (found[at].errno, found[at].unit) == (errno.ECONNRESET, 1)
        assert server.connections == 3


@pytest.mark.parametrize("max_in_flight", [1, 2, 16])
def test_host_that_drops_connections_is_not_asked_for_ever(
    talking_to: Talking, max_in_flight: int
) -> None:
    with talking_to(lambda peer, number: peer.read()) as (context, server):
        found = context.execute_many(
            reads(800), max_in_flight=max_in_flight, return_exceptions=True
        )
        assert all(isinstance(each, ModbusConnectionError) for each in found)
        assert [each.asked for each in found] == [str(each) for each in reads(800)]
        assert found[-1].sent == b""
        assert server.connections == 3


@pytest.mark.parametrize("max_in_flight", [1, 16])
def test_dead_host_costs_one_attempt(connect: Connect, max_in_flight: int) -> None:
    with dead() as port:
        context = connect(f"tcp://127.0.0.1:{port}", timeout=0.1)
        start = time.monotonic()
        found = context.execute_many(
            reads(800), max_in_flight=max_in_flight, return_exceptions=True
        )
        assert 0.1 <= time.monotonic() - start < 0.1 + LATE
        assert {each.errno for each in found} == {errno.ETIMEDOUT}
        with pytest.raises(ModbusConnectionError, match="address=0,"):
            context.execute_many(reads(800), max_in_flight=max_in_flight)
        assert time.monotonic() - start < 0.2 + LATE
        context.close()


def test_connection_closed_between_two_batches_is_made_anew(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        for _ in range(20):
            peer.send(echo(peer.read()))

    with talking_to(play) as (context, server):
        for _ in range(3):
            assert context.execute_many(reads(20)) == echoes(20)
            time.sleep(0.02)
        assert server.connections == 3


# --- busy ----------------------------------------------------------------------------------


def busy_at_first(busy: dict[int, int]) -> Callable[[Peer, int], None]:
    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            address = address_of(request)
            if busy.get(address, 0):
                busy[address] -= 1
                peer.send(refusal(request, 6))
            else:
                peer.send(echo(request))

    return play


@pytest.mark.parametrize("max_in_flight", [1, 16])
def test_busy_requests_are_asked_again(talking_to: Talking, max_in_flight: int) -> None:
    busy = {3: 2, 7: 1}
    with talking_to(busy_at_first(busy), busy_retries=2) as (context, _):
        assert context.execute_many(reads(50), max_in_flight=max_in_flight) == echoes(50)
        busy |= {3: 3, 40: 1}
        found = context.execute_many(reads(50), max_in_flight=max_in_flight, return_exceptions=True)
        assert isinstance(found[3], ServerDeviceBusy)
        assert [*found[:3], [3], *found[4:]] == echoes(50)
        busy[4] = 3
        with pytest.raises(ServerDeviceBusy, match="address=4,"):
            context.execute_many(reads(50), max_in_flight=max_in_flight)


def test_busy_is_a_failure_without_retries(talking_to: Talking) -> None:
    with (
        talking_to(busy_at_first({3: 1})) as (context, _),
        pytest.raises(ServerDeviceBusy, match="address=3,"),
    ):
        context.execute_many(reads(50))


# --- threads, signals, closing ---------------------------------------------------------------


def test_threads_share_a_context_and_batches(talking_to: Talking) -> None:
    with talking_to(good) as (context, _), ThreadPoolExecutor(3) as pool:

        def many(first: int) -> bool:
            return context.execute_many(reads(50, first)) == echoes(50, first)

        def one(address: int) -> bool:
            return context.read_holding_registers(address, 1) == [address]

        batches = [pool.submit(many, first) for first in range(0, 2000, 50)]
        singles = [pool.submit(one, address) for address in range(200)]
        assert all(each.result() for each in batches + singles)


def test_handles_of_several_units(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        while True:
            request = peer.read()
            peer.send(mbap(request, b"\x03\x02\0" + request[6:7]))

    with talking_to(play) as (context, _):
        assert context.for_unit(5).execute_many(reads(20)) == [[5]] * 20
        assert context.execute_many(reads(20)) == [[1]] * 20


def test_close_ends_a_batch_that_another_thread_waits_for(talking_to: Talking) -> None:
    asked = threading.Event()

    def play(peer: Peer, number: int) -> None:
        peer.read_all()
        asked.set()
        peer.read()

    with talking_to(play, timeout=20) as (context, server), ThreadPoolExecutor(1) as pool:
        waiting = pool.submit(context.execute_many, reads(50), return_exceptions=True)
        assert asked.wait(5)
        start = time.monotonic()
        context.close()
        found = waiting.result()
        assert time.monotonic() - start < LATE
        assert all(isinstance(each, ModbusConnectionError) for each in found)
        assert server.connections == 1
        with pytest.raises(ModbusConnectionError, match="closed"):
            context.execute_many(reads(1))


@pytest.fixture
def ctrl_c() -> Iterator[None]:
    """SIGINT interrupts, though a shell that runs the tests in the background ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("ctrl_c")
def test_ctrl_c_in_a_batch_leaves_a_usable_context(talking_to: Talking) -> None:
    def play(peer: Peer, number: int) -> None:
        if number == 0:
            peer.read_all()
            os.kill(os.getpid(), signal.SIGINT)
        good(peer)

    with talking_to(play, timeout=5) as (context, _):
        start = time.monotonic()
        with pytest.raises(KeyboardInterrupt):
            context.execute_many(reads(50))
        assert time.monotonic() - start < LATE
        assert context.execute_many(reads(50)) == echoes(50)
        assert context.read_holding_registers(4, 1) == [4]


def test_fork_leaves_the_parent_alone_and_the_child_connects_anew(url: str) -> None:
    asked = [pdu.ReadHoldingRegisters(100 + at, 1) for at in range(10)]
    with Context.from_url(url, unit=UNIT) as context:
        assert context.execute_many(asked) == echoes(10, 1000)
        child = os.fork()
        if child == 0:
            os._exit("://127" in url and context.execute_many(asked) != echoes(10, 1000))
        assert os.waitpid(child, 0)[1] == 0
        assert context.execute_many(asked) == echoes(10, 1000)


def test_no_descriptor_is_left_behind() -> None:
    def use(port: int) -> None:
        with TcpContext("127.0.0.1", port) as context:
            context.execute_many(reads(40), return_exceptions=True)
        TcpContext("127.0.0.1", port).execute_many(reads(3))
        gc.collect()

    with Played(closing_after(10)) as server:
        use(server.port)
        before = len(os.listdir("/proc/self/fd"))
        for _ in range(10):
            use(server.port)
        assert len(os.listdir("/proc/self/fd")) <= before + 1  # the server's own
