"""Many requests in flight on one connection: order, limits, and all that may go wrong."""

import errno
import os
import signal
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import (
    IllegalDataAddress,
    InvalidResponse,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    pdu,
)
from tests.support.c_programs import SOURCES, compile_c
from tests.support.clients import Connect, World, asking
from tests.support.interop import program
from tests.support.peers import OnRequest, TcpPeer, Write, echo, has_header, ignore, mbap
from tests.support.reads import echoes, on_read, reads

UNIT = 17

BY_ID = pytest.mark.parametrize("scheme", ["tcp", "udp"])


class Gathered:
    """
    Hands over requests together, when none came for a while. `play`: is given what came, and what
    answers it.
    """

    def __init__(
        self, world: World, play: Callable[[list[bytes], Write], object], quiet: float = 0.01
    ) -> None:
        self._events = world.network.events
        self._play = play
        self._quiet = quiet
        self._held: list[bytes] = []
        self._last = 0.0

    def __call__(self, request: bytes, write: Write) -> None:
        self._held.append(request)
        self._last = self._events.now
        self._events.after(self._quiet, self._look, write)

    def _look(self, write: Write) -> None:
        if self._held and self._events.now - self._last >= self._quiet - 1e-9:
            requests, self._held = self._held, []
            self._play(requests, write)


def address_of(request: bytes) -> int:
    return int.from_bytes(request[8:10], "big")


def refusal(request: bytes, code: int) -> bytes:
    return mbap(request, bytes([0x83, code]))


def failed(outcomes: list[Any], kind: type[ModbusError] = ModbusError) -> list[int]:
    """Return where failures stand."""
    return [at for at, outcome in enumerate(outcomes) if isinstance(outcome, kind)]


@pytest.mark.parametrize("most", [1, 16])
def test_results_have_the_order_of_requests_on_every_transport(
    connect: Connect, url: str, mapping: Mapping, most: int
) -> None:
    requests = [
        pdu.WriteRegisters(150, (7, 8, 9)),
        pdu.ReadCoils(10, 3),
        *(pdu.ReadHoldingRegisters(100 + at, 1) for at in range(10)),
        pdu.ReadFileRecords([(4, 1, 2)]),  # type: ignore[arg-type]
        pdu.ReadInputRegisters(200, 2),
    ]
    results = [None, [True, False, True], *echoes(10, 1000), [[1, 2]], [2000, 2001]]
    most = most if has_header(url.partition(":")[0]) else 1
    with connect(url, unit=UNIT, max_in_flight=most) as context:
        for _ in range(2):
            assert context.execute_many(requests) == results
            assert context.read_holding_registers(150, 3) == [7, 8, 9]
    assert mapping.holding_registers[150:153] == [7, 8, 9]


def test_refusals_stand_in_their_places_on_every_transport(connect: Connect, url: str) -> None:
    requests = [pdu.ReadCoils(10, 1), pdu.ReadHoldingRegisters(0, 1), pdu.ReadCoils(11, 1)]
    with connect(url, unit=UNIT) as context:
        first, refused, last = context.execute_many(requests, return_exceptions=True)
        assert (first, last) == ([True], [False])
        assert isinstance(refused, IllegalDataAddress)
        assert (refused.unit, refused.function) == (UNIT, 3)
        assert refused.asked == "ReadHoldingRegisters(address=0, count=1)"
        assert refused.sent
        assert refused.received
        with pytest.raises(IllegalDataAddress, match="address=0, count=1"):
            context.execute_many(requests)


def test_libmodbus_server_in_c(connect: Connect, tmp_path: Path) -> None:
    server = compile_c(SOURCES / "server.c", tmp_path / "server")
    requests = [pdu.ReadHoldingRegisters(100 + at % 100, 125) for at in range(800)]
    with program(server, "tcp", 0) as process:
        assert process.stdout is not None
        port = int(process.stdout.readline().split()[1])
        with connect(f"tcp://127.0.0.1:{port}", unit=UNIT, timeout=10) as context:
            results = context.execute_many(requests)
    assert results == [list(range(1100 + at % 100, 1225 + at % 100)) for at in range(800)]


def test_an_empty_list_of_requests_needs_no_connection(connect: Connect) -> None:
    context = connect("tcp://127.0.0.1:1")
    assert context.execute_many([]) == []
    assert context.read_many({}) == {}


@pytest.mark.parametrize(
    ("requests", "options", "kind", "message"),
    [
        (None, {}, TypeError, "requests must be a list"),
        ([*reads(3), "read"], {}, TypeError, r"requests\[3\] must be a request object"),
        ([pdu.ReadCoils], {}, TypeError, r"requests\[0\] must be a request object of pdu"),
    ],
)
def test_bad_arguments_cause_no_frame(world: World, requests, options, kind, message) -> None:
    peer = world.peer("tcp", on_read)
    with world.connect(peer.url, max_in_flight=16) as context:
        with pytest.raises(kind, match=message):
            context.execute_many(requests, **options)
        assert context.read_holding_registers(5, 1) == [5]
    assert len(peer.requests) == 1


def test_broadcast_of_a_read_is_refused_before_the_writes_go_out(world: World) -> None:
    unit = world.peer("rtu", ignore)
    with world.connect(unit.url, unit=0, turnaround=0) as everyone:
        with pytest.raises(ValueError, match=r"requests\[1\]: unit 0 is a broadcast"):
            everyone.execute_many([pdu.WriteRegister(1, 2), pdu.ReadCoils(0, 1)])
        assert unit.requests == []


def test_request_without_an_answer_times_out_alone(world: World) -> None:
    def play(request: bytes, write: Write) -> None:
        if address_of(request) not in (3, 20):
            write(echo(request))

    peer = world.peer("tcp", play)
    timeout = 60
    with world.connect(peer.url, timeout=timeout, unit=9, max_in_flight=16) as context:
        # The second is sent as soon as there is room for it, while the first waits.
        with world.lasting(timeout, more=0.01):
            outcomes = context.execute_many(reads(40), return_exceptions=True)
        silent = [outcomes[3], outcomes[20]]
        for error, address in zip(silent, (3, 20), strict=True):
            assert isinstance(error, ModbusTimeoutError)
            assert (error.unit, error.function, error.received) == (9, 3, b"")
            assert error.asked == f"ReadHoldingRegisters(address={address}, count=1)"
            assert error.sent[6:] == bytes([9, 3, 0, address, 0, 1])
        outcomes[3], outcomes[20] = [3], [20]
        assert outcomes == echoes(40)
        assert peer.connections == 1


@pytest.mark.parametrize("again", ["one", "many"])
def test_requests_left_after_a_failure_do_not_affect_later_ones(world: World, again: str) -> None:
    """The first is refused; answers to the other fifteen arrive during a later request."""
    late: list[bytes] = []

    def refused(requests: list[bytes], write: Write) -> None:
        late.extend(requests)
        write(refusal(late[0], 2))
        peer.on_request = Gathered(world, mixed)

    def mixed(fresh: list[bytes], write: Write) -> None:
        write(echo(late[-1]))
        for request in (*fresh, *reversed(late[1:-1])):
            write(echo(request))
        peer.on_request = on_read

    peer = world.peer("tcp", on_read)
    with world.connect(peer.url, max_in_flight=16) as context:
        for _ in range(2):
            assert context.read_holding_registers(1, 1) == [1]
        peer.on_request = Gathered(world, refused)
        with pytest.raises(IllegalDataAddress):
            context.execute_many(reads(400))
        assert len(late) == 16  # nothing was sent after the refusal
        if again == "one":
            assert context.read_holding_registers(900, 1) == [900]
        else:
            assert context.execute_many(reads(10, 900)) == echoes(10, 900)
        for address in range(500, 520):
            assert context.read_holding_registers(address, 1) == [address]
        assert (context.statistics.late_answers, peer.connections) == (15, 1)


def test_first_failure_in_the_order_of_requests_is_raised_at_once(world: World) -> None:
    """As soon as all requests before it are answered, whatever follows."""

    def play(requests: list[bytes], write: Write) -> None:
        for request in (refusal(requests[5], 4), *map(echo, requests[6:])):
            write(request)
        for request in (*map(echo, requests[3:5]), refusal(requests[1], 2)):
            write(request, after=0.05)
        for request in (echo(requests[0]), mbap(requests[2], b"\x04\x02\0\0")):
            write(request, after=0.051)
        peer.on_request = on_read

    peer = world.peer("tcp", Gathered(world, play))
    with world.connect(peer.url, timeout=60, max_in_flight=16) as context:
        with (
            world.lasting(0.051, more=0.02),
            pytest.raises(IllegalDataAddress, match="address=1,") as caught,
        ):
            context.execute_many(reads(30))
        assert caught.value.received[6:] == b"\x01\x83\x02"
        assert context.execute_many(reads(30)) == echoes(30)


@BY_ID
def test_wrong_answers_fail_their_own_requests_only(world: World, scheme: str) -> None:
    def play(request: bytes, write: Write) -> None:
        answers = {
            3: mbap(request, b"\x04\x02" + request[8:10]),
            5: echo(request, unit=99),
            7: mbap(request, b"\x03\x04" + request[8:12]),
            9: refusal(request, 77),
        }
        write(echo(request, transaction=1))
        write(answers.get(address_of(request), echo(request)))

    peer = world.peer(scheme, play)
    with world.connect(peer.url, max_in_flight=16) as context:
        outcomes = context.execute_many(reads(12), return_exceptions=True)
        for at in (3, 5, 7):
            assert isinstance(outcomes[at], InvalidResponse)
            assert outcomes[at].asked == f"ReadHoldingRegisters(address={at}, count=1)"
            assert outcomes[at].received
        assert "unit 99 answered" in str(outcomes[5])
        assert outcomes[9].code == 77
        assert failed(outcomes) == [3, 5, 7, 9]
        assert [outcome for outcome in outcomes if isinstance(outcome, list)] == [
            [at] for at in range(12) if at not in (3, 5, 7, 9)
        ]
        assert (context.statistics.late_answers, peer.connections) == (12, 1)


def closing_after(connections: Callable[[], int], *counts: int) -> OnRequest:
    """Answer so many requests on each connection, and close it when no more come."""
    requests: Counter[int] = Counter()

    def play(request: bytes, write: Write) -> None:
        number = connections()
        count = counts[min(number, len(counts)) - 1]
        requests[number] += 1
        if requests[number] <= count:
            write(echo(request))
        if requests[number] == max(count, 1):
            write(None, after=0.05)

    return play


def test_lost_connection_raises_for_the_first_without_an_answer(world: World) -> None:
    peer = world.peer("tcp", closing_after(lambda: peer.connections, 7, 0, 99))
    with world.connect(peer.url, max_in_flight=16) as context:
        with pytest.raises(ModbusConnectionError, match="address=7,") as caught:
            context.execute_many(reads(30))
        assert caught.value.errno == errno.ECONNRESET
        assert peer.connections == 2  # reads were sent once more, to no avail
        assert context.execute_many(reads(5)) == echoes(5)
        assert peer.connections == 3


def test_reads_of_which_nothing_was_answered_are_sent_once_more(world: World) -> None:
    peer = world.peer("tcp", closing_after(lambda: peer.connections, 10))
    with world.connect(peer.url, max_in_flight=4) as context:
        assert context.execute_many(reads(40)) == echoes(40)
        assert peer.connections == 4


def test_a_lost_connection_fails_only_requests_in_flight(world: World) -> None:
    peer = world.peer("tcp", closing_after(lambda: peer.connections, 10, 0, 99))
    with world.connect(peer.url, max_in_flight=4) as context:
        outcomes = context.execute_many(reads(40), return_exceptions=True)
        indexes = failed(outcomes, ModbusConnectionError)
        assert indexes == [10, 11, 12, 13]
        assert len({id(outcomes[at]) for at in indexes}) == len(indexes)
        for at in indexes:
            assert outcomes[at].asked == f"ReadHoldingRegisters(address={at}, count=1)"
            assert (outcomes[at].errno, outcomes[at].unit) == (errno.ECONNRESET, 1)
        assert peer.connections == 3


def test_threads_share_a_context_and_batches(connect: Connect) -> None:
    with (
        TcpPeer(on_read) as server,
        connect(server.url, timeout=30) as context,
        ThreadPoolExecutor(3) as pool,
    ):

        def many(first: int) -> bool:
            return context.execute_many(reads(50, first)) == echoes(50, first)

        def one(address: int) -> bool:
            return context.read_holding_registers(address, 1) == [address]

        batches = [pool.submit(many, first) for first in range(0, 500, 50)]
        singles = [pool.submit(one, address) for address in range(50)]
        assert all(future.result() for future in batches + singles)


def test_ctrl_c_in_a_batch_leaves_a_usable_context() -> None:
    def interrupt(request: bytes, write: Write) -> None:
        os.kill(os.getpid(), signal.SIGINT)
        server.on_request = on_read

    with TcpPeer(interrupt) as server, asking("blocking", server.url, timeout=600) as context:
        with pytest.raises(KeyboardInterrupt):
            context.execute_many(reads(50))
        assert context.execute_many(reads(50)) == echoes(50)
        assert context.read_holding_registers(4, 1) == [4]
