"""Functions that a program answers, and what fails in them."""

import logging
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import Access, Device, Mapping, pdu
from libmodbus_py.binding import library
from libmodbus_py.binding.library import replier
from libmodbus_py.protocol import errors
from libmodbus_py.serve import RecordFile
from tests.device.devices import new_device, words
from tests.protocol.pdu.examples import Doubled
from tests.support.cases import each_case


@pytest.fixture
def registered() -> Iterator[None]:
    pdu.register(Doubled)
    yield
    pdu.REQUESTS.pop(Doubled.function)


@pytest.mark.usefixtures("registered")
class TestHandlers:
    def test_handlers_get_the_request_and_their_result_is_sent(self) -> None:
        device = Device(Mapping(), handlers={Doubled: lambda request: request.values * 2})
        assert device.answer(b"\x41\2\0\7") == b"\x41\4\0\7\0\7"
        assert device.answer(b"\x41\4\0\7") == b"\xc1\3"

    def test_class_without_a_handler_is_an_illegal_function(self) -> None:
        assert Device(Mapping()).answer(b"\x41\0") == b"\xc1\1"

    def test_a_handler_of_one_device_does_not_serve_another_device(self) -> None:
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
    def test_bug_or_bad_result_is_a_failure(self, bad, caplog) -> None:
        caplog.clear()
        device = Device(Mapping(), handlers={Doubled: lambda request: bad})
        for _ in range(2):
            assert device.answer(b"\x41\0") == b"\xc1\4"
        assert len(caplog.records) == 1

    def test_hooks_are_not_called_for_a_handled_request(self) -> None:
        accesses: list[Access] = []
        device = Device(
            Mapping(),
            handlers={Doubled: lambda request: [1]},
            before_read=accesses.append,
            before_write=accesses.append,
            after_write=accesses.append,
        )
        assert device.answer(b"\x41\0") == b"\x41\2\0\1"
        assert accesses == []

    @each_case(
        "bad",
        [{0x41: len}, {"Doubled": len}, {int: len}, {Doubled: None}, {Doubled: 5}, {None: len}],
        ids=str,
    )
    def test_handlers_are_functions_by_class(self, bad: Any) -> None:
        with pytest.raises(TypeError, match=r"^handlers"):
            Device(Mapping(), handlers=bad)


class Broken(RecordFile):
    def has(self, record: int, length: int) -> bool:
        raise ZeroDivisionError("a bug of the application")


class TestFailures:
    def test_bug_is_answered_4_and_logged_once_for_each_function(self, caplog) -> None:
        device = Device(Mapping(holding_registers=1))
        device.files[1] = Broken([1])
        read = pdu.ReadFileRecords([(1, 0, 1)]).encode()
        write = pdu.WriteFileRecords([(1, 0, [1])]).encode()
        with caplog.at_level(logging.DEBUG):
            for _ in range(3):
                assert device.answer(read) == b"\x94\4"
                assert device.answer(write) == b"\x95\4"
        assert [record.levelno for record in caplog.records] == [logging.ERROR] * 2
        assert read.hex(" ") in caplog.records[0].getMessage()
        assert write.hex(" ") in caplog.records[1].getMessage()
        for record in caplog.records:
            assert record.exc_info
            assert record.exc_info[0] is ZeroDivisionError
            assert record.name.startswith("libmodbus_py")
        assert device.answer(b"\x03" + words(0, 1)) == b"\x03\2\0\0"

    def test_other_device_logs_its_own_bug(self, caplog: pytest.LogCaptureFixture) -> None:
        for _ in range(2):
            device = Device(Mapping())
            device.files[1] = Broken([1])
            assert device.answer(pdu.ReadFileRecords([(1, 0, 1)]).encode()) == b"\x94\4"
        assert len(caplog.records) == 2

    def test_an_exception_leaves_the_mapping_unlocked(self, caplog: pytest.LogCaptureFixture):
        device = Device(Mapping(holding_registers=1))
        device.files[1] = Broken([1])
        device.answer(pdu.ReadFileRecords([(1, 0, 1)]).encode())
        answers: list[bytes] = []
        thread = threading.Thread(
            target=lambda: answers.append(device.answer(b"\x03" + words(0, 1))), daemon=True
        )
        thread.start()
        thread.join(10)
        assert answers == [b"\x03\2\0\0"]
        assert len(caplog.records) == 1

    def test_failure_of_libmodbus_is_answered_4(self, monkeypatch, caplog) -> None:
        device = new_device()

        def fail() -> None:
            raise OSError("no descriptor left")

        with monkeypatch.context() as patch:
            patch.setattr(library, "replier", fail)
            assert device.answer(b"\x03" + words(100, 1)) == b"\x83\4"
            assert device.answer(b"\x03" + words(0, 1, 1)) == b"\x83\3"
        assert device.answer(b"\x03" + words(100, 1)) == b"\x03\2\0\0"
        assert len(caplog.records) == 1

    def test_an_answer_left_in_the_socketpair_is_not_sent_to_the_next_request(self) -> None:
        """libmodbus replies, and its reply cannot be received."""
        device = new_device()
        device.mapping.holding_registers[100:102] = [1, 2]
        answers: list[bytes] = []

        def work() -> None:
            own = replier()
            outlet, own.struct.outlet = own.struct.outlet, -1
            answers.append(device.answer(b"\x03" + words(100, 1)))
            assert own.struct.outlet != -1, outlet
            answers.extend(device.answer(b"\x03" + words(address, 1)) for address in (101, 100))

        thread = threading.Thread(target=work)  # the thread has a replier of its own
        thread.start()
        thread.join()
        assert answers == [b"\x83\x04", b"\x03\2\0\2", b"\x03\2\0\1"]
