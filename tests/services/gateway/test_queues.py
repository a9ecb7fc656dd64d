"""
Requests that wait in a gateway: how many, for how long, and in which order.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Fault, pdu
from tests.services.gateway.gates import READ_ONE, adu, gated, small
from tests.simulation.stage import Stage
from tests.support.gateways import passage


def test_one_more_than_may_wait_is_told_that_it_is_busy(stage: Stage) -> None:
    slow = {1: [Fault("delay", seconds=0.2)]}
    with (
        passage("tcp", "rtu", {1: small()}, faults=slow, queue=2, stage=stage) as through,
        stage.talk(through.url) as client,
    ):
        client.sendall(b"".join(adu(READ_ONE, number) for number in range(6)))
        refused = client.receive(3 * 9)
        assert refused[7::9] == b"\x83\x83\x83"
        assert refused[8::9] == bytes([6, 6, 6])
        assert [refused[at + 1] for at in (0, 9, 18)] == [3, 4, 5]
        with through.context(1) as other:  # one client fills its own queue only
            assert other.read_holding_registers(0, 1) == [0]
        assert client.receive(3 * 11)[8::11] == bytes([2, 2, 2])


def test_a_client_with_many_requests_has_others_wait_for_one(stage: Stage) -> None:
    with (
        gated(stage) as (gate, line, url),
        stage.talk(url) as eager,
        stage.talk(url) as modest,
    ):
        eager.sendall(adu(READ_ONE) * 15)
        assert stage.until(lambda: gate.asked)
        modest.sendall(adu(pdu.ReadHoldingRegisters(7, 1).encode()))
        assert stage.until(lambda: line.waiting == 15)
        gate.open()
        modest.receive(11)
        eager.receive(15 * 11)
        assert gate.asked.index(7) <= 2


def test_what_waits_for_too_long_is_told_so(stage: Stage) -> None:
    slow = {1: [Fault("delay", seconds=0.3)]}
    with (
        passage("tcp", "rtu", {1: small()}, faults=slow, longest_wait=0.1, stage=stage) as through,
        stage.talk(through.url) as client,
    ):
        client.sendall(adu(READ_ONE, 1) + adu(READ_ONE, 2))
        assert client.receive(11)[7] == 3
        assert client.receive(9)[7:] == b"\x83\6"


@pytest.mark.parametrize(("writes_first", "place"), [(True, 1), (False, 6)])
def test_writes_overtake_reads_where_they_may(stage: Stage, writes_first: bool, place: int) -> None:
    with (
        gated(stage, writes_first=writes_first) as (gate, line, url),
        stage.talk(url) as client,
    ):
        client.sendall(adu(READ_ONE) * 6 + adu(bytes.fromhex("06 0000 0001"), 9))
        assert stage.until(lambda: line.waiting == 6)
        gate.open()
        client.receive(6 * 11 + 12)
        assert gate.kinds.index("write") == place
