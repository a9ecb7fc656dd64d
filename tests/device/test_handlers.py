"""
Functions of one's own, with their handlers.
"""

from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Access, Device, Mapping, pdu
from libmodbus_py.protocol import errors
from tests.device.devices import words
from tests.protocol.pdu.examples import Doubled
from tests.support.cases import each_case


@pytest.fixture
def registered() -> Iterator[None]:
    pdu.register(Doubled)
    yield
    pdu.REQUESTS.pop(Doubled.function)


@pytest.mark.usefixtures("registered")
class TestHandlers:
    def test_handler_is_given_the_request_and_gives_its_result(self) -> None:
        device = Device(Mapping(), handlers={Doubled: lambda request: request.values * 2})
        assert device.answer(b"\x41\2\0\7") == b"\x41\4\0\7\0\7"
        assert device.answer(b"\x41\4\0\7") == b"\xc1\3"

    def test_class_without_a_handler_is_an_illegal_function(self) -> None:
        assert Device(Mapping()).answer(b"\x41\0") == b"\xc1\1"

    def test_handler_of_one_device_is_not_another_s(self) -> None:
        first = Device(Mapping(), handlers={Doubled: lambda request: [1]})
        second = Device(Mapping(), handlers={Doubled: lambda request: [2]})
        third = Device(Mapping())
        answers = [device.answer(b"\x41\0") for device in (first, second, third)]
        assert answers == [b"\x41\2\0\1", b"\x41\2\0\2", b"\xc1\1"]

    def test_handler_may_refuse(self) -> None:
        def refuse(request: Doubled) -> list[int]:
            raise errors.ExceptionResponse.of(request.values[0])

        device = Device(Mapping(), handlers={Doubled: refuse})
        for code in (*range(1, 12), 99, 255):
            assert device.answer(b"\x41\2" + words(code)) == bytes([0xC1, code])

    @each_case("bad", [None, "text", [-1], [65536], [0] * 126, [0] * 1000])
    def test_bug_or_bad_result_is_a_failure(
        self, bad: Any, caplog: pytest.LogCaptureFixture
    ) -> None:
        caplog.clear()
        device = Device(Mapping(), handlers={Doubled: lambda request: bad})
        for _ in range(2):
            assert device.answer(b"\x41\0") == b"\xc1\4"
        assert len(caplog.records) == 1

    def test_hooks_do_not_see_it(self) -> None:
        seen: list[Access] = []
        device = Device(
            Mapping(),
            handlers={Doubled: lambda request: [1]},
            before_read=seen.append,
            before_write=seen.append,
            after_write=seen.append,
        )
        assert device.answer(b"\x41\0") == b"\x41\2\0\1"
        assert seen == []

    @each_case(
        "bad",
        [{0x41: len}, {"Doubled": len}, {int: len}, {Doubled: None}, {Doubled: 5}, {None: len}],
        ids=str,
    )
    def test_handlers_are_functions_by_class(self, bad: Any) -> None:
        with pytest.raises(TypeError, match=r"^handlers"):
            Device(Mapping(), handlers=bad)
