"""
Equal reads that wait in a gateway are sent once, and all who asked are answered.
"""

from __future__ import annotations

import pytest

from libmodbus_py import pdu
from tests.services.gateway.gates import READ_ONE, adu, gated
from tests.simulation.stage import Stage


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
