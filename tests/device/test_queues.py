"""
Queues of registers, which function 24 reads.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Device, Mapping
from tests.device.devices import new_device, words
from tests.device.test_diagnostics import vector
from tests.support.cases import each_case


class TestQueues:
    def test_queue_is_that_of_the_example(self) -> None:
        device = Device(Mapping(), fifos={1246: [440, 4740]})
        assert device.answer(vector("s1-6.18-req")) == vector("s1-6.18-rsp")

    def test_reading_keeps_the_queue(self) -> None:
        device = Device(Mapping(), fifos={0: [1, 2]})
        for _ in range(3):
            assert device.answer(b"\x18\0\0") == b"\x18\0\6\0\2" + words(1, 2)
        assert device.fifos == {0: [1, 2]}

    @each_case("count", [0, 1, 30, 31])
    def test_up_to_31_registers_are_given(self, count: int) -> None:
        device = Device(Mapping(), fifos={65535: range(count)})
        answer = b"\x18" + words(2 + 2 * count, count) + words(*range(count))
        assert device.answer(b"\x18\xff\xff") == answer

    @each_case("count", [32, 33, 125, 40_000])
    def test_longer_queues_are_refused(self, count: int) -> None:
        device = Device(Mapping(), fifos={7: []})
        device.fifos[7] = [1] * count
        assert device.answer(b"\x18\0\7") == b"\x98\3"
        del device.fifos[7][31:]
        assert device.answer(b"\x18\0\7")[:5] == b"\x18\0\x40\0\x1f"

    def test_other_addresses_are_no_queues(self) -> None:
        device = Device(Mapping(holding_registers=10), fifos={7: [1]})
        for address in (0, 6, 8, 65535):
            assert device.answer(b"\x18" + words(address)) == b"\x98\2"
        assert new_device().answer(b"\x18\0\0") == b"\x98\2"
        assert device.answer(b"\x18\0\7\0") == b"\x98\3"  # the length comes first

    @pytest.mark.parametrize(
        ("fifos", "error"),
        [({-1: []}, ValueError), ({65536: []}, ValueError), ({"0": []}, TypeError)],
        ids=str,
    )
    def test_address_of_a_queue_is_one(self, fifos: Any, error: type[Exception]) -> None:
        with pytest.raises(error, match=r"^fifo must be "):
            Device(Mapping(), fifos=fifos)


@each_case(
    ("fifos", "message"),
    [({1: 5}, r"fifos\[1\] must be a list of registers, not 5"), ([1], "fifos must be {pointer ")],
)
def test_wrong_queues_are_refused_in_words(fifos: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        Device(Mapping(), fifos=fifos)
