"""
What others notice of a fault: their requests are answered, and the server stops.
"""

from __future__ import annotations

import pytest

from libmodbus_py import ModbusTimeoutError
from libmodbus_py.tools.faults.fault import Fault
from tests.simulation.stage import Stage
from tests.tools.faults.serving import FOREVER, READ, adu, client_of, serving


@pytest.mark.parametrize(
    "fault", [Fault("delay", seconds=FOREVER), Fault("trickle", seconds=FOREVER)]
)
@pytest.mark.parametrize("unit", [1, 2])
def test_others_are_answered_while_the_fault_lasts(stage: Stage, fault: Fault, unit: int) -> None:
    # The other client asks another unit, or the same one by another function.
    only = Fault(fault.kind, function=3, seconds=fault.seconds)
    with serving(stage, "tcp", {1: [only]}) as url, stage.talk(url) as slow:
        slow.sendall(adu(READ))
        head = slow.receive(1 if fault.kind == "trickle" else 0)
        with client_of(url, unit, timeout=5000) as client:
            for _ in range(20):
                assert client.read_coils(0, 8) == [False] * 8
        stage.pass_time(FOREVER / 2)
        assert not slow.has_input()
        assert head == (b"\0" if fault.kind == "trickle" else b"")


def test_a_server_stops_while_answers_wait(stage: Stage) -> None:
    with serving(stage, "tcp", {None: [Fault("delay", seconds=FOREVER)]}) as url:
        clients = [stage.talk(url) for _ in range(5)]
        for client in clients:
            client.sendall(adu(READ))
        stage.pass_time(1)
        begun = stage.now
    assert stage.now - begun < 0.01
    assert all(client.is_closed() for client in clients)


def test_a_serial_server_stops_while_an_answer_waits(stage: Stage) -> None:
    faults: dict[int | None, list[Fault]] = {None: [Fault("delay", seconds=FOREVER)]}
    with serving(stage, "rtu", faults) as url, client_of(url, timeout=50) as client:
        with pytest.raises(ModbusTimeoutError):
            client.read_coils(0, 1)
        begun = stage.now
    assert stage.now - begun < 0.01


def test_a_client_that_leaves_costs_its_answers_only(stage: Stage) -> None:
    with serving(stage, "tcp", {1: [Fault("delay", function=3, seconds=50)]}) as url:
        for _ in range(10):
            with stage.talk(url) as connection:
                connection.sendall(adu(READ) * 3)
        stage.pass_time(100)
        with client_of(url, timeout=5000) as client:
            assert client.read_holding_registers(0, 1) == [555]
