"""
Bugs of the user's code and of libmodbus: each is answered, and logged once.
"""

import logging
import threading

import pytest

from libmodbus_py import Device, Mapping, pdu
from libmodbus_py.device import reply
from libmodbus_py.device.reply import replier
from libmodbus_py.serve import RecordFile
from tests.device.devices import new_device, words


class Broken(RecordFile):
    def has(self, record: int, length: int) -> bool:
        raise ZeroDivisionError("a bug of the application")


class TestFailures:
    def test_bug_is_answered_4_and_logged_once_for_each_function(
        self, caplog: pytest.LogCaptureFixture
    ) -> None:
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

    def test_bug_leaves_the_mapping_free(self, caplog: pytest.LogCaptureFixture) -> None:
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

    def test_failure_of_libmodbus_is_answered_4(
        self, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        device = new_device()

        def fail() -> None:
            raise OSError("no descriptor left")

        with monkeypatch.context() as patch:
            patch.setattr(reply, "replier", fail)
            assert device.answer(b"\x03" + words(100, 1)) == b"\x83\4"
            assert device.answer(b"\x03" + words(0, 1, 1)) == b"\x83\3"
        assert device.answer(b"\x03" + words(100, 1)) == b"\x03\2\0\0"
        assert len(caplog.records) == 1

    def test_answer_left_in_the_socketpair_is_not_given_to_the_next_request(self) -> None:
        """libmodbus replies, and what it sent cannot be received."""
        device = new_device()
        device.mapping.holding_registers[100:102] = [1, 2]
        answers: list[bytes] = []

        def work() -> None:
            own = replier()
            outlet, own.struct.outlet = own.struct.outlet, -1
            answers.append(device.answer(b"\x03" + words(100, 1)))
            assert own.struct.outlet != -1, outlet
            answers.extend(device.answer(b"\x03" + words(address, 1)) for address in (101, 100))

        thread = threading.Thread(target=work)  # which has a replier of its own
        thread.start()
        thread.join()
        assert answers == [b"\x83\x04", b"\x03\2\0\2", b"\x03\2\0\1"]
