"""
What a client without transaction ids takes for an answer, and what it remembers of a flood.
"""

from __future__ import annotations

import pytest

from libmodbus_py import AsyncClient, FrameError, InvalidResponse, ModbusTimeoutError
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted, Write
from tests.support.talk import ASCII, LINE, Talk, ascii_frame, kinds, rtu, value

# More than an answer can have; longer texts of errors help nobody.
MOST = 600


@pytest.mark.parametrize("url", ["rtu+tcp://10.0.0.1", "rtu:///dev/line"])
def test_what_came_before_a_request_is_read_before_it(url: str) -> None:
    """It has come, and the event loop had no turn since: it answers no later request."""
    network = Network()
    answers: list[Write] = []

    def answer(request: bytes, write: Write) -> None:
        answers.append(write)
        write(value(int.from_bytes(request[2:4], "big")), 0.1)

    peer = Scripted(network, url, answer)

    async def main() -> None:
        async with AsyncClient(f"{peer.url}?unit=1") as plc:
            assert await plc.read_holding_registers(1, 1) == [1]
            answers[0](value(99))
            until = network.events.now + 0.05
            while network.events.now < until:
                network.events.advance(until)
            assert await plc.read_holding_registers(2, 1) == [2]
            assert len(peer.requests) == 2

    network.run(main)


@pytest.mark.parametrize("size", [1, 599, 600, 601, 5000])
def test_an_error_carries_what_came_up_to_a_bound(size: int) -> None:
    talk = Talk(LINE, timeout=1.0, retries=0)
    batch = talk.ask(1, go_on=True)
    flood = bytes(index % 251 for index in range(size))
    for at in range(0, size, 97):
        talk.come(flood[at : at + 97])
    talk.wait(1.0)
    (error,) = batch.outcomes
    assert isinstance(error, ModbusTimeoutError | FrameError)
    assert error.received == flood[:MOST]


@pytest.mark.parametrize("size", [1, 599, 600, 601, 5000])
def test_what_comes_while_a_unit_is_doubted_is_kept_up_to_a_bound(size: int) -> None:
    """It is the line that does not fall silent, and the error shows what was heard."""
    talk = Talk(LINE, timeout=1.0, retries=0)
    talk.ask(1, go_on=True)
    talk.wait(1.0)
    batch = talk.ask(2, go_on=True)
    flood = bytes(index % 251 for index in range(size))
    for at in range(0, size, 97):
        talk.come(flood[at : at + 97])
    while not batch.is_done:
        talk.come(b"")
        talk.wait(0.25)
        talk.come(b"\x00" if size < MOST else b"\x01")
        assert talk.now < 10
    (error,) = batch.outcomes
    assert isinstance(error, FrameError)
    assert "does not fall silent" in str(error)
    assert error.received is not None
    assert error.received[: min(size, MOST)] == flood[:MOST]
    assert len(error.received) <= MOST


def test_an_answer_of_another_unit_leaves_the_request_waiting() -> None:
    talk = Talk(LINE, timeout=1.0, retries=0)
    batch = talk.ask(7)
    talk.come(value(99, unit=2))
    talk.wait(0.9)
    assert not batch.is_done
    talk.come(value(7))
    assert batch.outcomes == [[7]]


def test_an_answer_of_another_unit_alone_is_named() -> None:
    talk = Talk(LINE, timeout=1.0, retries=0)
    batch = talk.ask(7, go_on=True)
    talk.come(value(99, unit=2))
    talk.wait(1.0)
    assert kinds(batch) == [InvalidResponse]
    assert "unit 2 answered" in str(batch.outcomes[0])


@pytest.mark.parametrize(
    ("url", "sent", "answer"),
    [
        (LINE, rtu("01 03 00 07 00 01"), value(7)),
        (ASCII, ascii_frame("01 03 00 07 00 01"), ascii_frame("01 03 02 00 07")),
    ],
    ids=["rtu", "ascii"],
)
def test_an_echo_does_not_end_the_wait_for_the_answer(url: str, sent: bytes, answer: bytes) -> None:
    talk = Talk(url, timeout=1.0, retries=0)
    batch = talk.ask(7)
    assert talk.sent == [sent]
    talk.come(sent)
    talk.wait(0.1)
    assert not batch.is_done
    talk.come(answer)
    talk.wait(0.1)
    assert batch.outcomes == [[7]]


def test_the_request_itself_alone_is_no_answer() -> None:
    talk = Talk(ASCII, timeout=1.0, retries=0)
    batch = talk.ask(8, go_on=True)
    talk.come(talk.sent[-1])
    talk.wait(1.0)
    assert kinds(batch) == [ModbusTimeoutError]
    assert "echo=True" in str(batch.outcomes[0])
