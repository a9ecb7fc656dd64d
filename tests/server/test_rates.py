"""How many requests of an address are answered in a second: `requests_per_second`."""

import gc
from contextlib import ExitStack

import pytest

from libmodbus_py.server.peer import READ_BYTES, Peer
from tests.simulation.lan import Lan
from tests.support.attacks import READ_ONE, adu
from tests.support.lan_server import ANSWER_ONE, ONE_ANSWER, OTHER, OVER_TCP, ask, rtu, server_on

KIND = pytest.mark.parametrize("kind", OVER_TCP)

# The beginning of a long request, which only silence tells from the whole one that follows.
NEVER_ENDED = bytes.fromhex("11 10 0000 007b f6")

# A header whose length cannot be: the connection is closed.
OUT_OF_STEP = bytes.fromhex("0001 0000 ffff 11 03")


@KIND
@pytest.mark.parametrize("rate", [20, 0.5])
def test_single_requests_are_limited_to_the_rate(lan: Lan, kind: str, rate: float) -> None:
    with server_on(lan, kind, requests_per_second=rate) as server:
        eager, other = server.connect(), server.connect(OTHER)
        at_once = max(1, int(rate))
        start = lan.now
        for number in range(at_once + 12):
            ask(eager, number)
        # Those at once are free, and the one that overdraws is answered.
        assert (12 - 1) / rate == pytest.approx(lan.now - start, abs=0.03)
        start = lan.now
        ask(other)
        assert lan.now - start < 0.001
        assert server.counts(requests=at_once + 13, connections=2, throttled=11)


@KIND
def test_requests_sent_at_once_wait_and_all_are_answered(lan: Lan, kind: str) -> None:
    """For longer than a frame may take, and one of them is cut where reading stopped."""
    count = 300
    with server_on(lan, kind, requests_per_second=100, frame_timeout=0.2) as server:
        eager, other = server.connect(), server.connect(OTHER)
        start = lan.now
        eager.sendall(b"".join(adu(READ_ONE, number) for number in range(count)))
        assert lan.until(lambda: server.statistics.throttled)
        for number in range(50):
            ask(other, number)
        assert lan.now - start < 0.1
        answers = b"".join(adu(ANSWER_ONE, number) for number in range(count))
        assert eager.receive(len(answers)) == answers
        at_once = READ_BYTES // len(adu(READ_ONE))
        assert (count - 100 - at_once) / 100 - 0.001 <= lan.now - start <= (count - 100) / 100
        assert server.counts(requests=count + 50, connections=2, closed_slow=0)


def peers_in_memory() -> int:
    gc.collect()
    return sum(isinstance(get_object, Peer) for get_object in gc.get_objects())


@KIND
def test_a_connection_lost_while_it_waits_leaves_nothing(lan: Lan, kind: str) -> None:
    before = peers_in_memory()  # errors that pytest keeps may refer to peers
    with server_on(lan, kind, requests_per_second=0.001) as server:
        for number in range(20):
            eager = server.connect(f"10.3.0.{1 + number}")
            eager.sendall(adu(READ_ONE) * 2)
            assert eager.receive(2 * ONE_ANSWER) == adu(ANSWER_ONE) * 2
            eager.sendall(adu(READ_ONE))
            assert server.counts(connections=1, throttled=1 + number)
            eager.reset()
            assert server.counts(connections=0)
        assert peers_in_memory() <= before


@KIND
def test_connections_of_an_address_share_its_rate(lan: Lan, kind: str) -> None:
    with server_on(lan, kind, requests_per_second=10) as server:
        eager = [server.connect() for _ in range(8)]
        start = lan.now
        while lan.now < start + 10:
            for client in eager:
                client.sendall(adu(READ_ONE))
            lan.pass_time(0.05)
        requests = server.statistics.requests
        # Ten are free, ten come in each second, and one read may overdraw.
        at_once = READ_BYTES // len(adu(READ_ONE))
        assert 10 * 11 - 1 <= requests <= 10 * 11 + at_once
        moment = lan.now
        ask(server.connect(OTHER))
        assert lan.now - moment < 0.01
        assert server.statistics.throttled >= 8


@KIND
@pytest.mark.parametrize(
    ("count", "rest"), [(1, b""), (2, OUT_OF_STEP)], ids=["one", "two and what ends it"]
)
def test_a_new_connection_gets_no_new_allowance(lan: Lan, kind: str, count, rest) -> None:
    with server_on(lan, kind, requests_per_second=5) as server:
        start = lan.now
        for _ in range(100):
            with server.connect() as client:
                client.sendall(count * adu(READ_ONE) + rest)
                lan.pass_time(0.02)
        # Five are free, and a read may overdraw.
        free = 5 + 5 * (lan.now - start)
        assert free - 2 <= server.statistics.requests <= free + count
        assert lan.until(lambda: server.statistics.connections == 0)


def test_a_refused_connection_gets_no_new_allowance(lan: Lan) -> None:
    limits = {"requests_per_second": 0.5, "max_connections": 1, "when_full": "refuse"}
    with server_on(lan, "plain", **limits) as server:
        with server.connect() as eager:
            ask(eager)
            ask(eager)
        assert server.counts(connections=0)
        with server.connect(OTHER) as other:
            ask(other)
            assert server.connect().is_closed()
        assert server.counts(connections=0, refused_full=1)
        before = server.statistics.throttled
        server.connect().sendall(adu(READ_ONE))
        assert server.counts(throttled=before + 1)


@KIND
def test_closing_a_waiting_connection_does_not_delay_the_others(lan: Lan, kind: str):
    with server_on(lan, kind, requests_per_second=2) as server:
        first, second = server.connect(), server.connect()
        for _ in range(4):
            ask(first)
        first.sendall(adu(READ_ONE))
        assert server.counts(throttled=2)
        second.sendall(adu(READ_ONE))
        assert server.counts(throttled=3)
        first.reset()
        waited = lan.now
        assert second.receive(ONE_ANSWER) == adu(ANSWER_ONE)
        assert lan.now - waited <= 0.5


def test_frames_that_end_with_silence_count_as_requests(lan: Lan) -> None:
    with server_on(lan, "plain", "rtu+tcp", requests_per_second=2, idle_timeout=1) as server:
        sly, idle = server.connect(), server.connect()
        start = lan.now
        for _ in range(300):
            sly.sendall(NEVER_ENDED + rtu(READ_ONE))
            lan.pass_time(0.05)
        seconds = lan.now - start
        assert server.statistics.throttled >= 1
        # Its whole allowance, what one read may overdraw, and what it gets meanwhile.
        assert 2 * seconds <= server.statistics.requests <= 2 + READ_BYTES // 15 + 2 * seconds
        assert idle.is_closed()


def test_a_thousand_waiting_requests_are_all_answered(lan: Lan) -> None:
    """Each in its turn: none is forgotten, however many there are."""
    limits = {"requests_per_second": 10, "connections_per_address": 1000}
    with server_on(lan, "plain", **limits) as server, ExitStack() as stack:
        eager = [stack.enter_context(server.connect()) for _ in range(1000)]
        start = lan.now
        for client in eager:
            client.sendall(adu(READ_ONE))
        for client in eager:
            assert client.receive(ONE_ANSWER) == adu(ANSWER_ONE)
        assert lan.now - start == pytest.approx((1000 - 10 - 1) / 10, abs=0.2)
        assert server.counts(requests=1000)
