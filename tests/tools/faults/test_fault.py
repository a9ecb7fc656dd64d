"""
Which requests a fault happens to: every n-th, of a unit, a function, a range; and faults that
cannot be, which are refused with the name of the argument.
"""

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import Server, pdu
from libmodbus_py.protocol.framing import Frame
from libmodbus_py.server.faults import Faults
from libmodbus_py.tools.faults.fault import Fault
from tests.support.golden import Refused
from tests.tools.faults.serving import READ, REQUEST, make_device


def hits(faults: Faults, count: int, request: Frame = REQUEST) -> list[int]:
    """Which of the next requests meet a fault, counted from 1."""
    due = (faults.due(request, has_transaction=True) for _ in range(count))
    return [number for number, fault in enumerate(due, start=1) if fault is not None]


@given(every=st.integers(1, 50), count=st.integers(0, 200))
def test_every_nth_request_has_the_fault(every: int, count: int) -> None:
    faults = Faults({1: [Fault("no_answer", every=every)]})
    assert hits(faults, count) == list(range(every, count + 1, every))


def test_a_seed_selects_the_same_requests_each_time() -> None:
    fault = Fault("no_answer", probability=0.25, seed=7)
    first = hits(Faults({1: [fault]}), 1000)
    assert first == hits(Faults({1: [fault]}), 1000)
    assert 200 < len(first) < 300
    other = Fault("no_answer", probability=0.25, seed=8)
    assert first != hits(Faults({1: [other]}), 1000)
    assert hits(Faults({1: [Fault("no_answer", probability=0.0)]}), 100) == []
    assert hits(Faults({1: [Fault("no_answer", probability=1)]}), 3) == [1, 2, 3]


def test_only_the_given_unit_and_function_have_the_fault_and_are_counted() -> None:
    faults = Faults({1: [Fault("no_answer", function=3, every=2)]})
    assert hits(faults, 1) == []
    assert hits(faults, 5, Frame(2, READ)) == []
    assert hits(faults, 5, Frame(1, b"\x01\0\0\0\1")) == []
    assert hits(faults, 1) == [1]


# What a fault is for, a request, and whether it is hit.
RANGES: list[tuple[dict[str, Any], pdu.Request[Any], bool]] = [
    ({"address": 10}, pdu.ReadHoldingRegisters(10, 1), True),
    ({"address": 10}, pdu.ReadHoldingRegisters(9, 1), False),
    ({"address": 10}, pdu.ReadHoldingRegisters(11, 1), False),
    ({"address": 10}, pdu.ReadHoldingRegisters(0, 11), True),
    ({"address": 10}, pdu.ReadCoils(10, 1), True),
    ({"address": 10}, pdu.WriteCoil(10, True), True),
    ({"address": 10, "count": 3}, pdu.ReadInputRegisters(12, 5), True),
    ({"address": 10, "count": 3}, pdu.ReadInputRegisters(13, 5), False),
    ({"address": 0, "count": 65536}, pdu.ReadDiscreteInputs(65535, 1), True),
    ({"address": 10, "table": "coils"}, pdu.ReadHoldingRegisters(10, 1), False),
    ({"address": 10, "table": "coils"}, pdu.WriteCoils(3, [True] * 8), True),
    ({"table": "holding_registers"}, pdu.WriteRegisters(500, [1]), True),
    ({"table": "holding_registers"}, pdu.MaskWriteRegister(500, 1, 1), True),
    ({"table": "holding_registers"}, pdu.ReadInputRegisters(500, 1), False),
    ({"address": 10}, pdu.ReadWriteRegisters(10, 1, 20, [1]), True),
    ({"address": 20}, pdu.ReadWriteRegisters(10, 1, 20, [1]), True),
    ({"address": 15}, pdu.ReadWriteRegisters(10, 1, 20, [1]), False),
    ({"address": 10, "function": 6}, pdu.WriteRegister(10, 1), True),
    ({"address": 10, "function": 6}, pdu.ReadHoldingRegisters(10, 1), False),
    ({"address": 0}, pdu.ReportServerId(), False),
    ({"address": 10}, pdu.ReadFifoQueue(10), False),
    ({"address": 10}, pdu.ReadFileRecords([(1, 10, 1)]), False),
]


@pytest.mark.parametrize(("where", "request_", "is_hit"), RANGES, ids=str)
def test_only_requests_in_the_range_have_the_fault_and_are_counted(where, request_, is_hit) -> None:
    faults = Faults({1: [Fault("no_answer", every=2, **where)]})
    request = Frame(1, request_.encode())
    assert hits(faults, 4, request) == ([2, 4] if is_hit else [])


def test_an_invalid_fault_is_refused(refused: Refused) -> None:
    refused("refused.txt", lambda settings: Fault(**settings))
    with pytest.raises(ValueError, match=r"probability must be in 0..1"):
        Fault("no_answer", probability=float("nan"))


@pytest.mark.parametrize(
    ("faults", "message"),
    [
        ([Fault("no_answer")], "faults must be"),
        ({256: [Fault("no_answer")]}, r"faults: unit must be in 0..255, not 256"),
        ({1: ["no_answer"]}, "faults must be .*, not 'no_answer'"),
    ],
)
def test_invalid_faults_are_refused(faults: Any, message: str) -> None:
    with pytest.raises((TypeError, ValueError), match=message):
        Server(make_device(), faults=faults)
