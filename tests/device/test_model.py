"""Devices answer as a model of the specification does, whether in C or in Python."""

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from libmodbus_py import Device, Mapping
from tests.device.devices import contents, new_device
from tests.device.model import KNOWN, Model
from tests.device.request_pdus import request_pdus


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


@pytest.mark.parametrize("start", [-1, -(1 << 40), 13, 1 << 40])
def test_a_start_outside_the_data_is_refused(start: int) -> None:
    frame = bytes.fromhex("0001 0000 0006 01 03 0000 0001")
    with pytest.raises(ValueError, match=r"start must be in 0\.\.12, not"):
        Device(Mapping(holding_registers=1)).answer_chunk(frame, start, 1)


@pytest.mark.parametrize("unit", [-1, 256, 1 << 40])
def test_an_invalid_unit_is_refused(unit: int) -> None:
    frame = bytes.fromhex("0001 0000 0006 01 03 0000 0001")
    with pytest.raises(ValueError, match=r"unit must be in 0\.\.255, not"):
        Device(Mapping(holding_registers=1)).answer_chunk(frame, 0, unit)
