"""
Answers that a gateway gives again while they are fresh.
"""

from __future__ import annotations

from libmodbus_py import Device, Mapping
from tests.simulation.stage import Stage
from tests.support.gateways import passage


def test_answers_are_given_again_until_they_are_old_or_something_is_written(stage: Stage) -> None:
    reads: list[int] = []
    device = Device(
        Mapping(10, 10, 10, 10), before_read=lambda access: reads.append(access.address)
    )
    with (
        passage("tcp", "rtu", {1: device}, route={"cache": 30}, stage=stage) as through,
        through.context(1) as context,
        through.context(1) as other,
    ):
        for client in (context, other) * 5:
            assert client.read_holding_registers(2, 2) == [0, 0]
        assert len(reads) == 1
        other.write_register(3, 9)
        for client in (context, other):
            assert client.read_holding_registers(2, 2) == [0, 9]
        assert len(reads) == 2
        assert context.read_exception_status() == 0  # may change what it likes
        assert context.read_holding_registers(2, 2) == [0, 9]


def test_an_answer_that_is_too_old_is_not_given_again(stage: Stage) -> None:
    reads: list[int] = []
    device = Device(
        Mapping(10, 10, 10, 10), before_read=lambda access: reads.append(access.address)
    )
    with (
        passage("tcp", "rtu", {1: device}, route={"cache": 30}, stage=stage) as through,
        through.context(1) as context,
    ):
        context.read_holding_registers(2, 2)
        stage.pass_time(29.9)
        context.read_holding_registers(2, 2)
        assert len(reads) == 1
        stage.pass_time(0.1)
        context.read_holding_registers(2, 2)
        assert len(reads) == 2
