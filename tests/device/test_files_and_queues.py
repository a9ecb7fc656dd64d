"""Files of records: holes, limits, writes that are all or nothing; and queues, function 24."""

from typing import Any

import pytest

from libmodbus_py import Device, Mapping, pdu
from libmodbus_py.serve import RecordFile
from tests.device.devices import new_device, words
from tests.device.test_diagnostics import vector
from tests.support.cases import each_case
from tests.support.golden import Refused


class TestFiles:
    @staticmethod
    def read(*subs: tuple[int, int, int]) -> bytes:
        return pdu.ReadFileRecords(subs).encode()

    @staticmethod
    def write(*subs: tuple[int, int, list[int]]) -> bytes:
        return pdu.WriteFileRecords(subs).encode()

    def test_gaps_in_a_file_are_no_records(self) -> None:
        device = Device(Mapping(), files={3: {9: 0x33CD, 10: 0x0040, 12: 7}})
        assert device.answer(self.read((3, 9, 2))) == bytes.fromhex("140605 0633CD0040")
        assert device.answer(self.read((3, 12, 1))) == b"\x14\4\3\6\0\7"
        for sub in ((3, 8, 1), (3, 8, 2), (3, 9, 3), (3, 11, 1), (3, 12, 2), (3, 13, 1), (3, 0, 1)):
            assert device.answer(self.read(sub)) == b"\x94\2"
            assert device.answer(self.write((*sub[:2], [1] * sub[2]))) == b"\x95\2"
        assert device.answer(self.read((2, 9, 1))) == b"\x94\2"
        assert list(device.files[3]) == [0x33CD, 0x0040, 7]

    def test_writes_are_all_or_nothing(self) -> None:
        device = Device(Mapping(), files={1: [0] * 10, 2: [0] * 10})
        for last in ((2, 9, [5, 5]), (3, 0, [5]), (2, 10, [5])):
            answer = device.answer(self.write((1, 0, [1, 2]), (2, 3, [3]), last))
            assert answer == b"\x95\2"
            assert list(device.files[1]) + list(device.files[2]) == [0] * 20
        request = self.write((1, 0, [1, 2]), (2, 3, [3]), (1, 1, [9]))
        assert device.answer(request) == request
        assert list(device.files[1]) == [1, 9, 0, 0, 0, 0, 0, 0, 0, 0]
        assert list(device.files[2]) == [0, 0, 0, 3, 0, 0, 0, 0, 0, 0]

    def test_record_file_is_indexed_by_record(self) -> None:
        file = RecordFile({9: 1, 12: 2})
        file[9] = 65535
        assert (file[9], file[12], len(file), list(file)) == (65535, 2, 2, [65535, 2])
        for record in (0, 10, 13, 9999, 10_000, -1, -4):
            with pytest.raises(IndexError):
                file[record]
            with pytest.raises(IndexError):
                file[record] = 1
        for bad in (-1, 65536):
            with pytest.raises(ValueError, match="value"):
                file[9] = bad
        with pytest.raises(TypeError, match="value"):
            file[9] = "1"  # type: ignore[assignment]
        assert list(RecordFile([5, 6])) == [5, 6]
        assert list(RecordFile([])) == list(RecordFile({})) == []

    def test_mapping_must_be_a_mapping(self) -> None:
        for bad in (None, {}, 5):
            with pytest.raises(TypeError, match="mapping must be a Mapping"):
                Device(bad)  # type: ignore[arg-type]


def test_wrong_files_are_refused_with_a_reason(refused: Refused) -> None:
    refused("wrong_files.txt", lambda files: Device(Mapping(), files=files))


def test_a_number_of_records() -> None:
    device = Device(Mapping(), files={4: 100, 5: 0})
    assert list(device.files[4]) == [0] * 100
    assert not device.files[4].has(100, 1)
    assert list(device.files[5]) == []


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

    def test_addresses_without_a_queue_are_refused(self) -> None:
        device = Device(Mapping(holding_registers=10), fifos={7: [1]})
        for address in (0, 6, 8, 65535):
            assert device.answer(b"\x18" + words(address)) == b"\x98\2"
        assert new_device().answer(b"\x18\0\0") == b"\x98\2"
        assert device.answer(b"\x18\0\7\0") == b"\x98\3"  # the length is checked first

    @pytest.mark.parametrize(
        ("fifos", "error"),
        [({-1: []}, ValueError), ({65536: []}, ValueError), ({"0": []}, TypeError)],
        ids=str,
    )
    def test_the_address_of_a_queue_must_be_an_address(self, fifos: Any, error: type[Exception]):
        with pytest.raises(error, match=r"^fifo must be "):
            Device(Mapping(), fifos=fifos)


@each_case(
    ("fifos", "message"),
    [({1: 5}, r"fifos\[1\] must be a list of registers, not 5"), ([1], "fifos must be {pointer ")],
)
def test_wrong_queues_are_refused_with_a_reason(fifos: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        Device(Mapping(), fifos=fifos)
