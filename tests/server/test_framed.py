"""
The base of sessions: what is found in received bytes, what is written and traced, and its state.
"""

import struct
from typing import Any

import pytest

from libmodbus_py import Device, Server, framing
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.protocol.errors import FrameError
from libmodbus_py.protocol.framing import Frame
from libmodbus_py.server.framed import Framed, SessionSettings
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.service import SessionState
from tests.simulation.stage import Stage
from tests.support.attacks import adu, ask, connect
from tests.support.chunks import FakeChannel

ASKED, ANSWER = bytes.fromhex("03 0000 0001"), bytes.fromhex("03 02 0007")

# What the fixture `device` is asked, and answers.
READ, READ_ANSWER = bytes.fromhex("03 0064 0002"), bytes.fromhex("03 04 03e8 03e9")


class Channel(FakeChannel):
    """A channel that remembers what happens to it."""

    def __init__(self) -> None:
        self.written: list[bytes] = []
        self.traced: list[tuple[str, bytes, int | None]] = []
        self.followed = 0
        super().__init__(self.written.append, self._count)
        self.trace: Any = self

    def _count(self) -> None:
        self.followed += 1

    def tell(
        self, direction: str, adu: bytes, unit: int | None = None, function: int | None = None
    ) -> None:
        assert (unit is None) == (function is None)
        self.traced.append((direction, adu, unit))


class Session(Framed):
    """Answers each request in the same way."""

    def __init__(self, *, has_turns: bool = False) -> None:
        endpoint = parse("tcp://10.0.0.1")
        settings = SessionSettings(endpoint, ServerStatistics(), has_turns=has_turns)
        self.channel: Channel
        super().__init__(settings, Channel(), lambda unit: unit == 1)

    def answer(self, request: Frame) -> Frame:
        return request._replace(pdu=ANSWER)


def framed(pdu: bytes, number: int) -> bytes:
    return struct.pack(">HHHB", number, 0, len(pdu) + 1, 1) + pdu


def request(number: int = 1) -> bytes:
    return framed(ASKED, number)


def answer(number: int = 1) -> bytes:
    return framed(ANSWER, number)


def test_each_request_is_answered_traced_and_counted() -> None:
    session = Session()
    assert session.state.value == "reading"
    assert session.receive(request(1) + request(2)) == 2
    assert session.channel.written == [answer(1), answer(2)]
    assert session.channel.traced == [
        ("received", request(1), 1),
        ("received", request(2), 1),
        ("sent", answer(1), 1),
        ("sent", answer(2), 1),
    ]
    assert (session.statistics.requests, session.statistics.refused) == (2, 0)
    assert session.state.value == "reading"
    assert session.channel.followed == 0


def test_a_frame_whose_end_is_missing_is_waited_for() -> None:
    session = Session()
    assert session.receive(request()[:9]) == 0
    assert session.state.value == "unfinished"
    assert session.receive(request()[9:]) == 1
    assert session.state.value == "reading"


def test_of_many_requests_four_are_answered_at_a_time() -> None:
    session = Session(has_turns=True)
    counts = [session.receive(b"".join(map(request, range(10))))]
    while session.state is SessionState.BEHIND:
        followed = session.channel.followed
        counts.append(session.receive(b""))
        assert session.channel.followed == followed + (session.state is SessionState.BEHIND)
    assert counts == [4, 4, 2]
    assert session.channel.written == [answer(number) for number in range(10)]


def test_a_stream_that_cannot_be_understood_ends_after_its_requests() -> None:
    session = Session()
    assert session.receive(request() + b"\xff" * 300) == 1
    assert session.channel.written == [answer()]
    assert session.state.value == "behind"
    with pytest.raises(FrameError, match="out of step"):
        session.receive(b"")


def test_the_rest_of_what_came_is_traced_once() -> None:
    for end in (Session.end, Session.close):
        session = Session()
        session.receive(request()[:9])
        for _ in range(3):
            end(session)
        assert session.channel.traced == [("received", request()[:9], None)]
        assert session.state.value == "reading"


def test_frames_that_are_not_answered_any_more_are_traced() -> None:
    session = Session(has_turns=True)
    session.receive(b"".join(map(request, range(6))))
    session.end()
    received = [adu for direction, adu, _ in session.channel.traced if direction == "received"]
    assert received == [request(number) for number in range(6)]
    assert session.channel.written == [answer(number) for number in range(4)]


# --- requests that arrive glued together or cut in pieces ---------------------------------


@pytest.mark.timeout(60)
def test_an_illegal_request_does_not_cost_its_neighbours_their_answers(port: int) -> None:
    """modbus_reply would sleep half a second for each, a minute and a half for all."""
    requests = [READ, b"\x03\x00\x64\x00\x00", READ, b"\x41", READ, b"\x06\x09", READ]
    answers = [READ_ANSWER, b"\x83\x03", READ_ANSWER, b"\xc1\x01", READ_ANSWER, b"\x86\x03"]
    answers.append(READ_ANSWER)
    requests, answers = requests * 60, answers * 60
    with connect(port) as connection:
        asked = b"".join(adu(body, number) for number, body in enumerate(requests))
        ask(connection, asked, b"".join(adu(body, number) for number, body in enumerate(answers)))


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp"])
def test_a_request_cut_anywhere_is_answered(stage: Stage, scheme: str, device: Device) -> None:
    framers: dict[str, framing.Framer] = {
        "tcp": framing.TcpFramer(),
        "rtu+tcp": framing.RtuFramer("server"),
        "ascii+tcp": framing.AsciiFramer(),
    }
    framer = framers[scheme]
    request = framer.encode(framing.Frame(17, READ))
    answer = framer.encode(framing.Frame(17, READ_ANSWER))
    with Server(device).background(f"{scheme}://10.0.0.1:0") as running:
        for cut in range(1, len(request)):
            with stage.talk(running.urls[0]) as client:
                client.sendall(request[:cut])
                stage.pass_time(0.03)
                client.sendall(request[cut:] + request)
                # A line has no transaction ids: only the last of two requests is answered.
                answers = answer * (2 if scheme == "tcp" else 1)
                assert client.receive(len(answers)) == answers, cut
