"""
Which numbers units may have, in devices, faults and `own_unit`; and faults that cannot happen.
"""

from __future__ import annotations

import pytest

from libmodbus_py import Device, Fault, Mapping, Server
from libmodbus_py.protocol.framing import Frame
from libmodbus_py.tools.faults.answers import Faults

READ = b"\3\0\0\0\1"


@pytest.mark.parametrize("unit", [0, 255])
def test_units_are_a_byte(unit: int) -> None:
    device = Device(Mapping(1, 1, 1, 1))
    made = Server({unit: device}, {unit: [Fault("no_answer")]}, own_unit=unit)
    assert made.statistics.requests == 0


@pytest.mark.parametrize("unit", [-1, 256])
def test_other_units_are_refused(unit: int) -> None:
    device = Device(Mapping(1, 1, 1, 1))
    with pytest.raises(ValueError, match="unit"):
        Server({unit: device})
    with pytest.raises(ValueError, match="unit"):
        Server({1: device}, {unit: [Fault("no_answer")]})
    with pytest.raises(ValueError, match="own_unit"):
        Server({1: device, 2: device}, own_unit=unit)


def test_one_device_for_all_units_is_none_of_them() -> None:
    with pytest.raises(ValueError, match="own_unit cannot be given"):
        Server(Device(Mapping(1, 1, 1, 1)), own_unit=0)


def test_a_fault_that_cannot_happen_leaves_others_their_turn() -> None:
    """Serial lines have no transactions."""
    transaction, answer = Fault("wrong_transaction"), Fault("no_answer")
    for has_transaction, expected in ((True, transaction), (False, answer)):
        faults = Faults({1: [transaction, answer]})
        found = faults.due(Frame(1, READ), has_transaction=has_transaction)
        assert found == expected


def test_a_fault_of_another_function_leaves_others_their_turn() -> None:
    faults = Faults({1: [Fault("no_answer", function=6), Fault("exception", code=2)]})
    found = faults.due(Frame(1, READ), has_transaction=True)
    assert found is not None
    assert found.kind == "exception"


def test_the_faults_of_a_unit_come_before_those_of_all() -> None:
    faults = Faults({None: [Fault("no_answer")], 1: [Fault("exception", code=2, every=2)]})
    kinds = []
    for _ in range(4):
        found = faults.due(Frame(1, READ), has_transaction=True)
        assert found is not None
        kinds.append(found.kind)
    assert kinds == ["no_answer", "exception", "no_answer", "exception"]


def test_faults_that_are_given_again_go_on_counting() -> None:
    third, other = Fault("no_answer", every=3), Fault("exception", code=2, every=3)
    before = Faults({1: [third]})
    for _ in range(2):
        assert before.due(Frame(1, READ), has_transaction=True) is None
    after = Faults({1: [third, third, other]}, before)
    found = [after.due(Frame(1, READ), has_transaction=True) for _ in range(3)]
    assert found == [third, None, third]


def test_no_faults_are_none() -> None:
    assert not Faults({})
    assert not Faults({1: [], None: []})
    assert Faults({1: [], 2: [Fault("no_answer")]})
    faults = Faults({1: [Fault("no_answer")]})
    assert [faults.concerns(unit) for unit in (0, 1, 2)] == [False, True, False]
    assert Faults({None: [Fault("no_answer")]}).concerns(7)


@pytest.mark.parametrize("pdu", [b"\x41\1", b"\x08\0\0\0\7", b"\x07", b"\3"])
def test_a_fault_everywhere_happens_to_requests_without_an_address(pdu: bytes) -> None:
    everywhere = Faults({1: [Fault("no_answer")]})
    assert everywhere.due(Frame(1, pdu), has_transaction=True) is not None
    in_a_table = Faults({1: [Fault("no_answer", table="coils")]})
    assert in_a_table.due(Frame(1, pdu), has_transaction=True) is None
