"""
Functions of one's own, with their handlers.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Access, Device, Mapping, pdu
from libmodbus_py.protocol import errors
from tests.device.devices import words
from tests.support.cases import each_case


class Sum(pdu.Request[int]):
    """A function of our own: some registers are asked for, one is answered."""

    function = 0x64
    request_length = pdu.counted(2, at=1)
    response_length = pdu.unknown_length

    def __init__(self, values: bytes) -> None:
        self.values = values

    def encode(self) -> bytes:
        return bytes([self.function, len(self.values)]) + self.values

    @classmethod
    def decode(cls, pdu: bytes) -> Sum:
        return cls(pdu[2:])

    def encode_response(self, result: Any) -> bytes:
        if isinstance(result, bytes):
            return bytes([self.function]) + result
        return bytes([self.function]) + words(result)

    def _decode_response(self, pdu: bytes) -> int:
        return int.from_bytes(pdu[1:], "big")


@pytest.fixture
def own_function() -> Iterator[type[Sum]]:
    yield pdu.register(Sum)
    pdu.REQUESTS.pop(Sum.function)


@pytest.mark.usefixtures("own_function")
class TestHandlers:
    def test_handler_is_given_the_request_and_gives_its_result(self) -> None:
        device = Device(Mapping(), handlers={Sum: lambda request: sum(request.values)})
        assert device.answer(b"\x64\3\1\2\3") == b"\x64\0\6"
        assert device.answer(b"\x64\3\1\2") == b"\xe4\3"

    def test_class_without_a_handler_is_an_illegal_function(self) -> None:
        assert Device(Mapping()).answer(b"\x64\0") == b"\xe4\1"

    def test_handler_of_one_device_is_not_another_s(self) -> None:
        first = Device(Mapping(), handlers={Sum: lambda request: 1})
        second = Device(Mapping(), handlers={Sum: lambda request: 2})
        third = Device(Mapping())
        answers = [device.answer(b"\x64\0") for device in (first, second, third)]
        assert answers == [b"\x64\0\1", b"\x64\0\2", b"\xe4\1"]

    def test_handler_may_refuse(self) -> None:
        def refuse(request: Sum) -> int:
            raise errors.ExceptionResponse.of(request.values[0])

        device = Device(Mapping(), handlers={Sum: refuse})
        for code in (*range(1, 12), 99, 255):
            assert device.answer(bytes([0x64, 1, code])) == bytes([0xE4, code])

    @each_case("bad", [None, "text", -1, 65536, bytes(253), bytes(1000)])
    def test_bug_or_bad_result_is_a_failure(
        self, bad: Any, caplog: pytest.LogCaptureFixture
    ) -> None:
        caplog.clear()
        device = Device(Mapping(), handlers={Sum: lambda request: bad})
        for _ in range(2):
            assert device.answer(b"\x64\0") == b"\xe4\4"
        assert len(caplog.records) == 1

    def test_hooks_do_not_see_it(self) -> None:
        seen: list[Access] = []
        device = Device(
            Mapping(),
            handlers={Sum: lambda request: 1},
            before_read=seen.append,
            before_write=seen.append,
            after_write=seen.append,
        )
        assert device.answer(b"\x64\0") == b"\x64\0\1"
        assert seen == []

    @each_case(
        "bad", [{0x64: len}, {"Sum": len}, {int: len}, {Sum: None}, {Sum: 5}, {None: len}], ids=str
    )
    def test_handlers_are_functions_by_class(self, bad: Any) -> None:
        with pytest.raises(TypeError, match=r"^handlers"):
            Device(Mapping(), handlers=bad)
