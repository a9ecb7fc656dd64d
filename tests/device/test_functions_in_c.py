"""
The functions of which C answers no request, because a hook wants all addresses that there are.
"""

import pytest

from libmodbus_py import Device, Hook, Mapping, Point, RegisterMap
from tests.support.cases import each_case

READ, READ_INPUT, WRITE, WRITE_SEVERAL, MASK, WRITE_AND_READ = 3, 4, 6, 16, 22, 23


@each_case(
    ("hooked", "is_in_c"),
    [
        pytest.param([range(10, 20), range(30, 40)], False, id="all that there are"),
        pytest.param([range(40)], False, id="all, and a hole"),
        pytest.param([range(65536)], False, id="the whole table"),
        pytest.param([range(10, 20), range(30, 39)], True, id="all but the last"),
        pytest.param([range(11, 40)], True, id="all but the first"),
        pytest.param([range(10, 20)], True, id="one of two ranges"),
        pytest.param([], True, id="none"),
    ],
)
def test_reads_are_left_when_a_hook_wants_them_all(hooked: list[range], is_in_c: bool) -> None:
    mapping = Mapping(holding_registers=[range(10, 20), range(30, 40)], input_registers=40)
    device = Device(mapping, before_read=Hook(print, holding_registers=hooked))
    assert (READ in device.in_c, WRITE_AND_READ in device.in_c) == (is_in_c, is_in_c)
    assert {READ_INPUT, WRITE, WRITE_SEVERAL, MASK} <= device.in_c


def test_two_hooks_may_want_all_together() -> None:
    mapping = Mapping(holding_registers=20)
    first, second = (Hook(print, holding_registers=each) for each in (range(9), range(9, 20)))
    device = Device(mapping, before_write=first, after_write=second)
    assert device.in_c.isdisjoint({WRITE, WRITE_SEVERAL, MASK, WRITE_AND_READ})
    assert READ in device.in_c
    assert WRITE in Device(mapping, before_write=first).in_c


def test_hooks_of_other_tables_are_no_reason() -> None:
    hook = Hook(print, coils=range(5), files=range(9))
    device = Device(Mapping(coils=5, holding_registers=5), before_write=hook, before_read=hook)
    assert device.in_c.isdisjoint({1, 5, 15})
    assert {READ, READ_INPUT, WRITE, WRITE_SEVERAL, MASK, WRITE_AND_READ} <= device.in_c


def test_bounds_of_all_points_are_a_reason_too() -> None:
    points = [Point("low", "holding_registers", 0, maximum=9), Point("raw", "holding_registers", 1)]
    assert WRITE in Device.of_map(RegisterMap(points)).in_c
    assert WRITE not in Device.of_map(RegisterMap(points[:1])).in_c


def test_what_is_left_gets_the_same_answers() -> None:
    """Also outside of the table, and with wrong counts, which C would refuse."""
    told: list[object] = []
    mapping = Mapping(holding_registers=range(10, 20))
    hooked = Device(mapping, before_read=Hook(told.append, holding_registers=range(10, 20)))
    plain = Device(mapping)
    for address, count in ((10, 10), (9, 1), (19, 2), (65535, 1), (10, 0), (10, 126)):
        request = bytes([READ, *address.to_bytes(2, "big"), *count.to_bytes(2, "big")])
        frame = bytes([0, 1, 0, 0, 0, 1 + len(request), 1]) + request
        _, answers, requests, _ = plain.answer_chunk(frame, 0, 1)
        assert requests == 1
        assert hooked.answer(request) == answers[7:]
    assert len(told) == 1


@pytest.mark.parametrize("start", [-1, -(1 << 40), 13, 1 << 40])
def test_a_start_outside_the_data_is_refused(start: int) -> None:
    frame = bytes.fromhex("0001 0000 0006 01 03 0000 0001")
    with pytest.raises(ValueError, match=r"start must be in 0\.\.12, not"):
        Device(Mapping(holding_registers=1)).answer_chunk(frame, start, 1)


@pytest.mark.parametrize("unit", [-1, 256, 1 << 40])
def test_a_unit_that_cannot_be_is_refused(unit: int) -> None:
    frame = bytes.fromhex("0001 0000 0006 01 03 0000 0001")
    with pytest.raises(ValueError, match=r"unit must be in 0\.\.255, not"):
        Device(Mapping(holding_registers=1)).answer_chunk(frame, 0, unit)
