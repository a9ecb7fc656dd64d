"""
Devices answer as a model of the specification does, whether in C or in Python.
"""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Device, Hook, Mapping, Point, RegisterMap
from tests.device.devices import contents, new_device
from tests.device.model import KNOWN, Model
from tests.device.request_pdus import request_pdus
from tests.support.cases import each_case


def contents_of_model(model: Model) -> dict[str, Any]:
    return {
        "coils": list(model.bits[1].values()),
        "discrete_inputs": list(model.bits[2].values()),
        "holding_registers": list(model.words[3].values()),
        "input_registers": list(model.words[4].values()),
    } | {f"file {number}": list(records.values()) for number, records in model.files.items()}


class TestAgainstTheModel:
    def test_the_model_knows_the_twelve_functions(self) -> None:
        assert KNOWN == [1, 2, 3, 4, 5, 6, 15, 16, 20, 21, 22, 23]

    @settings(max_examples=60)
    @given(st.lists(request_pdus(), min_size=1, max_size=12))
    def test_answers_and_contents_are_the_same(self, requests: list[bytes]) -> None:
        device, model = new_device(), Model()
        # Discrete inputs and input registers are the device's own to set.
        device.mapping.discrete_inputs[20:30] = [1] * 10
        device.mapping.input_registers[200:400] = range(200)
        model.bits[2].update(dict.fromkeys(range(20, 30), 1))
        model.words[4].update(zip(range(200, 400), range(200), strict=True))
        for request in requests:
            assert device.answer(request).hex(" ") == model.answer(request).hex(" ")
        assert contents(device) == contents_of_model(model)

    @settings(max_examples=75)
    @given(
        st.builds(
            lambda code, body: bytes([code]) + body,
            st.sampled_from(KNOWN) | st.integers(128, 255),
            st.binary(max_size=252),
        )
    )
    def test_noise_gets_the_same_answer(self, request_pdu: bytes) -> None:
        device, model = new_device(), Model()
        assert device.answer(request_pdu).hex(" ") == model.answer(request_pdu).hex(" ")
        assert contents(device) == contents_of_model(model)


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
