"""
Equal reads that wait in a gateway are sent once, and all who asked are answered.
"""

from __future__ import annotations

import pytest

from libmodbus_py import pdu
from tests.services.gateway.gates import READ_ONE, adu, gated
from tests.simulation.stage import Stage


def test_equal_reads_that_wait_are_asked_once(stage: Stage) -> None:
    same = pdu.ReadHoldingRegisters(5, 1).encode()
    with (
        gated(stage, {"merge": True}) as (gate, line, url),
        stage.talk(url) as one,
        stage.talk(url) as other,
    ):
        one.sendall(adu(READ_ONE, 1) + adu(same, 2))
        assert stage.until(lambda: line.waiting == 1)
        other.sendall(adu(same, 3) + adu(same, 4))
        assert stage.until(lambda: line.units[1].merged == 2)
        gate.open()
        assert one.receive(22)[12] == 2
        answers = other.receive(22)
        assert (answers[1], answers[12]) == (3, 4)
        assert gate.asked == [0, 5]


@pytest.mark.parametrize("leaving", [("one",), ("other",), ("one", "other")], ids="-".join)
def test_who_leaves_does_not_take_away_what_others_joined(
    stage: Stage, leaving: tuple[str, ...]
) -> None:
    """A merged read is asked as long as one of those who wanted it is there, and not after that."""
    same = pdu.ReadHoldingRegisters(5, 1).encode()
    with (
        gated(stage, {"merge": True}) as (gate, line, url),
        stage.talk(url) as blocker,
        stage.talk(url) as one,
        stage.talk(url) as other,
    ):
        blocker.sendall(adu(READ_ONE, 1))
        assert stage.until(lambda: gate.asked)
        for number, client in enumerate((one, other), start=2):
            client.sendall(adu(same, number))
            stage.pass_time(1)
        assert (line.waiting, line.units[1].merged) == (1, 1)
        clients = {"one": one, "other": other}
        for name in leaving:
            clients[name].close()
            stage.pass_time(1)
        assert line.waiting == (len(leaving) < 2)
        gate.open()
        assert blocker.receive(11)[:2] == b"\0\1"
        for number, (name, client) in enumerate(clients.items(), start=2):
            if name not in leaving:
                assert client.receive(11)[:2] == bytes([0, number])
        stage.pass_time(1)
        assert gate.asked == ([0, 5] if len(leaving) < 2 else [0])
        assert line.unwanted == (len(leaving) == 1)
        assert (line.waiting, line.in_flight) == (0, 0)


@pytest.mark.parametrize("leaving", ["one", "other"])
def test_an_answer_is_unwanted_by_whoever_left_while_it_was_on_its_way(
    stage: Stage, leaving: str
) -> None:
    same = pdu.ReadHoldingRegisters(5, 1).encode()
    with (
        gated(stage, {"merge": True}) as (gate, line, url),
        stage.talk(url) as one,
        stage.talk(url) as other,
    ):
        one.sendall(adu(READ_ONE, 1) + adu(same, 2))
        stage.pass_time(1)
        other.sendall(adu(same, 3))
        stage.pass_time(1)
        assert line.units[1].merged == 1
        {"one": one, "other": other}[leaving].reset()
        stage.pass_time(1)
        gate.open()
        left, answers = (other, 11) if leaving == "one" else (one, 22)
        assert len(left.receive(answers)) == answers
        assert gate.asked == [0, 5]
        # Who left wanted the first one, too.
        assert line.unwanted == (2 if leaving == "one" else 1)


def test_a_read_after_one_that_was_given_up_is_asked_for_itself(stage: Stage) -> None:
    """A read that no client waits for any more cannot be joined."""
    same = pdu.ReadHoldingRegisters(5, 1).encode()
    with (
        gated(stage, {"merge": True}) as (gate, line, url),
        stage.talk(url) as blocker,
        stage.talk(url) as gone,
        stage.talk(url) as later,
    ):
        blocker.sendall(adu(READ_ONE, 1))
        stage.pass_time(1)
        gone.sendall(adu(same, 2))
        stage.pass_time(1)
        gone.close()
        stage.pass_time(1)
        later.sendall(adu(same, 3))
        stage.pass_time(1)
        gate.open()
        assert later.receive(11)[:2] == b"\0\3"
        assert gate.asked == [0, 5]
        assert line.units[1].merged == 0


def test_a_read_after_a_write_is_not_one_with_a_read_before_it(stage: Stage) -> None:
    same = pdu.ReadHoldingRegisters(5, 1).encode()
    write = pdu.WriteRegister(5, 7).encode()
    with gated(stage, {"merge": True}) as (gate, line, url), stage.talk(url) as client:
        client.sendall(adu(READ_ONE, 1) + adu(same, 2) + adu(write, 3) + adu(same, 4))
        assert stage.until(lambda: line.waiting == 3)
        gate.open()
        assert client.receive(11 + 11 + 12 + 11)[-2:] == b"\0\7"
