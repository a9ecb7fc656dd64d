"""The connections of a server and their turns, with sessions that do what a test says."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py.ports.hosts import host_and_port
from libmodbus_py.server.limits import Limits, ServerStatistics
from libmodbus_py.server.peer import Peer
from libmodbus_py.server.peers import Peers
from libmodbus_py.server.service import SessionState
from tests.simulation.stage import Stage, Talker

Receive = Callable[["Session", bytes], int]


class Session:
    """A session that notes what it gets; the test says what it answers, and its state."""

    def __init__(self, endpoint: FakeEndpoint, peer: Peer) -> None:
        self.peer = peer
        self.state = SessionState.READING
        self.received: list[bytes] = []
        self.times: list[float] = []
        self.is_ended = self.is_closed = False
        self._endpoint = endpoint

    def receive(self, data: bytes) -> int:
        self.received.append(data)
        self.times.append(self._endpoint.stage.now)
        self._endpoint.order.append(self)
        return self._endpoint.on_receive(self, data)

    def end(self) -> None:
        self.is_ended = True
        if self.state is not SessionState.OWING:
            self.state = SessionState.READING

    def close(self) -> None:
        self.is_closed = True


def echo(session: Session, data: bytes) -> int:
    session.peer.write(data)
    return 1


def ignore(session: Session, data: bytes) -> int:
    return 0


class FakeEndpoint:
    """
    An address at which `Peers` take connections.

    Attributes:
        sessions: those of all connections, oldest first.
        order: the sessions in the order in which they got bytes.
        ends: how often a hook has ended the program.
    """

    def __init__(self, stage: Stage, on_receive: Receive = echo, **limits: Any) -> None:
        self.stage = stage
        self.on_receive = on_receive
        self.statistics = ServerStatistics()
        self.sessions: list[Session] = []
        self.order: list[Session] = []
        self.ends = 0
        self._url = stage.listen("tcp://10.0.0.1:0", self._accept)

        async def made() -> Peers:
            return Peers(Limits(**limits), self.statistics, self._end, stage._epoll)

        self.peers = stage.wait(made())

    def _accept(self, end: Any, address: tuple[str, int]) -> None:
        self.peers.admit(end, address[0], host_and_port(*address), self._session)

    def _session(self, peer: Peer) -> Session:
        self.sessions.append(Session(self, peer))
        return self.sessions[-1]

    def _end(self) -> None:
        self.ends += 1

    def talk(self) -> tuple[Talker, Session]:
        talker = self.stage.talk(self._url)
        self.stage.pass_time(0.001)
        return talker, self.sessions[-1]


Open = Callable[..., FakeEndpoint]


@pytest.fixture
def endpoint(stage: Stage) -> Iterator[Open]:
    made: list[FakeEndpoint] = []

    def opened(*args: Any, **limits: Any) -> FakeEndpoint:
        made.append(FakeEndpoint(stage, *args, **limits))
        return made[-1]

    yield opened
    for each in made:
        each.peers.close()
        each.peers.close()
        assert all(session.is_closed for session in each.sessions)
        assert len(each.peers) == each.statistics.connections == 0


def test_answers_are_sent_when_all_were_read(stage: Stage, endpoint: Open) -> None:
    server = endpoint(echo)
    talkers = [server.talk()[0] for _ in range(3)]
    sent_before: list[int] = []

    def note(session: Session, data: bytes) -> int:
        session.peer.write(data)
        session.peer.write(b"!")
        sent_before.append(sum(talker.end.other.sent for talker in talkers))
        return 1

    server.on_receive = note
    for talker in talkers:
        talker.send(b"ask")
    assert [talker.receive(4) for talker in talkers] == [b"ask!"] * 3
    assert sent_before == [0, 0, 0]


def test_calls_for_later_come_after_all_were_read_and_before_answers(stage: Stage, endpoint: Open):
    server = endpoint()
    talkers = [server.talk()[0] for _ in range(2)]
    told: list[str] = []

    def defer(session: Session, data: bytes) -> int:
        told.append("read")

        def call() -> None:
            told.append("called")
            session.peer.write(data)

        server.peers.later(call)
        return 1

    server.on_receive = defer
    for talker in talkers:
        talker.send(b"x")
    assert [talker.recv(9) for talker in talkers] == [b"x", b"x"]
    assert told == ["read", "read", "called", "called"]


def test_a_call_that_fails_leaves_the_others(stage: Stage, endpoint: Open, caplog) -> None:
    server = endpoint()
    talker, _ = server.talk()

    def fail() -> None:
        raise RuntimeError("a defect")

    def defer(session: Session, data: bytes) -> int:
        server.peers.later(fail)
        server.peers.later(lambda: session.peer.write(data))
        return 1

    server.on_receive = defer
    talker.send(b"x")
    assert talker.recv(9) == b"x"
    assert "requests are lost" in caplog.text
    assert server.ends == 0


def test_who_is_behind_goes_on_without_new_bytes(stage: Stage, endpoint: Open) -> None:
    server = endpoint()
    talkers = [server.talk() for _ in range(20)]

    def in_steps(session: Session, data: bytes) -> int:
        is_over = len(session.received) >= 5
        session.state = SessionState.READING if is_over else SessionState.BEHIND
        session.peer.write(b"%d" % len(session.received))
        session.peer.follow()
        return 1

    server.on_receive = in_steps
    for talker, _ in talkers:
        talker.send(b"go")
    for talker, session in talkers:
        assert talker.receive(5) == b"12345"
        assert session.received == [b"go", b"", b"", b"", b""]
    # Nobody goes on twice before the others did once.
    assert len(server.order) == 5 * len(talkers)
    assert set(Counter(server.order[: 3 * len(talkers)]).values()) == {3}


def test_who_is_held_or_behind_is_not_read(stage: Stage, endpoint: Open) -> None:
    server = endpoint()
    talker, session = server.talk()

    def held(session: Session, data: bytes) -> int:
        session.state = SessionState.HELD
        session.peer.follow()
        return 1

    server.on_receive = held
    talker.send(b"first")
    stage.pass_time(1)
    talker.send(b"second")
    stage.pass_time(1)
    assert session.received == [b"first"]
    server.on_receive = echo
    session.state = SessionState.READING
    session.peer.follow()
    assert talker.recv(9) == b"second"


def test_a_session_that_fails_costs_its_connection_only(stage: Stage, endpoint: Open, caplog):
    server = endpoint()
    (bad, failing), (good, _) = server.talk(), server.talk()

    def broken(session: Session, data: bytes) -> int:
        if session is failing:
            raise RuntimeError("a defect")
        return echo(session, data)

    server.on_receive = broken
    bad.send(b"x")
    good.send(b"y")
    assert good.recv(9) == b"y"
    assert bad.is_closed()
    assert "connection closed" in caplog.text
    assert server.statistics.connections == 1


def test_who_sends_no_more_is_closed_although_the_answer_never_comes(stage: Stage, endpoint: Open):
    server = endpoint(ignore, frame_timeout=8)
    talker, session = server.talk()
    session.state = SessionState.OWING
    begun = stage.now
    talker.shutdown(1)
    assert talker.is_closed()
    assert 8 <= stage.now - begun <= 9.01
    assert server.statistics.closed_slow == 1


def test_the_time_of_a_frame_stands_still_while_nothing_is_read(stage: Stage, endpoint: Open):
    def unfinished(session: Session, data: bytes) -> int:
        session.state = SessionState.UNFINISHED
        return 0

    server = endpoint(unfinished, frame_timeout=1.0, idle_timeout=None, max_unsent=100)
    talker, session = server.talk()
    talker.end.other.capacity = 100
    talker.send(b"<")
    stage.pass_time(0.1)
    session.peer.write(bytes(1000))
    stage.pass_time(50)
    assert not session.is_closed
    assert server.statistics.paused == 1
    talker.receive(1000)
    stage.pass_time(0.9)
    assert not session.is_closed
    stage.pass_time(0.6)
    assert session.is_closed
