"""The identifier of a server (function 17), and device identification (function 43/14)."""

from typing import Any

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import ExceptionResponse, InvalidResponse
from libmodbus_py.protocol.pdu import (
    EncapsulatedTransport,
    IdentificationPage,
    ReadDeviceIdentification,
    ReportServerId,
    ServerId,
    decode_request,
)
from libmodbus_py.protocol.pdu.interface import LAST_OBJECT, identify, pages
from tests.support.cases import each_case


class TestServerId:
    def test_identifier_is_one_byte_unless_split_again(self) -> None:
        server_id = ReportServerId().decode_response(b"\x11\6abc\xffde")
        assert server_id == ServerId(b"a", None, b"bc\xffde")
        assert ServerId.split(b"abc\xffde", 3) == ServerId(b"abc", True, b"de")

    def test_the_data_of_a_server_id_are_restored_from_its_parts(self) -> None:
        for data in (b"\xb4\xff", b"\xb4\0", b"\xb4\xff3.1.6", b"ACME", b"A\x01", bytes(251)):
            response = bytes([0x11, len(data)]) + data
            server_id = ReportServerId().decode_response(response)
            assert server_id.data == data
            assert ReportServerId().encode_response(server_id) == response
            for length in range(len(data)):
                assert ServerId.split(server_id.data, length).data == data

    def test_only_00_and_ff_state_whether_the_device_runs(self) -> None:
        for byte in range(256):
            server_id = ServerId.split(bytes([0x01, byte, 0x02]))
            assert server_id.running is {0x00: False, 0xFF: True}.get(byte)
            assert server_id.additional == (b"\2" if byte in (0x00, 0xFF) else bytes([byte, 2]))

    def test_split_accepts_any_length_that_leaves_the_indicator(self) -> None:
        assert ServerId.split(b"\xff", 0) == ServerId(b"", True)
        assert ServerId.split(b"ab\xff", 2) == ServerId(b"ab", True)
        for data, length in ((b"", 0), (b"a", 1), (b"ab\xff", 3), (b"ab\xff", -1)):
            with pytest.raises(ValueError, match="length"):
                ServerId.split(data, length)


# Two fill a page exactly, with their heads; the last ones are private.
OBJECTS = {
    0: b"v" * 120,
    1: b"c" * 122,
    2: b"r",
    3: b"u" * 244,
    4: b"",
    6: b"a" * 3,
    128: b"p" * 244,
    129: b"q" * 200,
    255: b"z" * 42,
}


def served(objects: dict[int, bytes], level: str | int) -> tuple[dict[int, bytes], list[int]]:
    """Return what a client gets from a device with these objects, and its requests."""
    steps = identify(level)
    request = next(steps)
    numbers: list[int] = []
    while True:
        numbers.append(request.object_id)
        assert len(numbers) <= 300
        body = request.encode_response(pages(request, objects)._replace(conformity=0x83))
        assert len(body) <= pdu.MAX_PDU
        again = decode_request(request.encode())
        assert again == request
        try:
            request = steps.send(again.decode_response(body))
        except StopIteration as done:
            identification: pdu.DeviceIdentification = done.value
            break
    assert identification.conformity == 0x83
    return identification.objects, numbers


class TestIdentification:
    @pytest.mark.parametrize(
        ("level", "numbers", "objects"),
        [
            ("basic", [0, 1, 2], [0, 2]),
            ("regular", [0, 1, 2, 3, 4, 6], [0, 2, 3, 4]),
            ("extended", list(OBJECTS), [0, 2, 3, 4, 128, 129]),
        ],
    )
    def test_objects_are_split_into_as_many_pages_as_needed(self, level, numbers, objects) -> None:
        values, requests = served(OBJECTS, level)
        assert values == {number: OBJECTS[number] for number in numbers}
        assert list(values) == numbers
        assert requests == objects

    def test_a_page_is_filled_to_the_last_byte(self) -> None:
        request = ReadDeviceIdentification(1)
        full = {0: bytes(120), 1: bytes(122)}
        assert pages(request, full) == IdentificationPage(0, None, full)
        over = {0: bytes(120), 1: bytes(123)}
        assert pages(request, over) == IdentificationPage(0, 1, {0: bytes(120)})

    @pytest.mark.parametrize(
        ("code", "unknown"),
        [(1, [3, 4, 6, 7, 128, 255]), (2, [5, 7, 127, 128, 255]), (3, [5, 7, 130, 254])],
    )
    def test_an_unknown_object_restarts_from_the_first(self, code: int, unknown: list[int]) -> None:
        first = pages(ReadDeviceIdentification(code, 0), OBJECTS)
        for number in unknown:
            assert pages(ReadDeviceIdentification(code, number), OBJECTS) == first

    def test_a_page_begins_with_the_requested_object(self) -> None:
        for code, last in LAST_OBJECT.items():
            for number in OBJECTS:
                if number <= last:
                    page = pages(ReadDeviceIdentification(code, number), OBJECTS)
                    assert next(iter(page.objects)) == number
                    assert min(page.objects) == number

    def test_a_single_object_is_requested_once(self) -> None:
        for number in (0, 6, 200, 255):
            steps = identify(number)
            assert next(steps) == ReadDeviceIdentification(4, number)
            with pytest.raises(StopIteration) as stop:
                steps.send(IdentificationPage(0x81, None, {number: b"x"}))
            assert stop.value.value == pdu.DeviceIdentification(0x81, {number: b"x"})

    @each_case(
        ("pages_", "numbers"),
        [
            ([(0, {0: b"a"})], [0]),  # the same again
            ([(1, {0: b"a"}), (1, {1: b"b"})], [0, 1]),  # stays
            ([(2, {0: b"a"}), (1, {2: b"c"})], [0, 2]),  # goes back
            ([(2, {0: b"a", 1: b"b"}), (2, {0: b"a", 1: b"b"})], [0, 2]),  # starts over
            ([(1, {0: b"a", 1: b"b"})], [0]),  # was there already
            ([(1, {}), (1, {})], [0, 1]),  # nothing, for ever
            ([(5, {}), (3, {})], [0, 5]),
        ],
    )
    def test_a_device_whose_next_object_repeats_is_invalid(self, pages_, numbers) -> None:
        steps = identify("regular")
        requests = [next(steps)]
        *good, bad = pages_
        for following, objects in good:
            requests.append(steps.send(IdentificationPage(2, following, objects)))
        with pytest.raises(InvalidResponse) as caught:
            steps.send(IdentificationPage(2, *bad))
        assert [request.object_id for request in requests] == numbers
        assert caught.value.function == 43
        assert caught.value.asked == str(requests[-1])

    @each_case("level", ["basic", "regular", "extended"])
    @each_case("following", [0, 1, 2])
    def test_a_repeated_next_object_ends_a_basic_identification(self, level: str, following: int):
        steps = identify(level)
        next(steps)
        assert steps.send(IdentificationPage(2, 2, {0: b"a", 1: b"b"})).object_id == 2
        with pytest.raises(StopIteration) as stop:
            steps.send(IdentificationPage(2, following, {2: b"c"}))
        identification = pdu.DeviceIdentification(2, {0: b"a", 1: b"b", 2: b"c"}, complete=False)
        assert stop.value.value == identification

    @pytest.mark.parametrize("next_object", [None, 3])
    def test_a_page_that_claims_more_objects_than_it_has_returns_those_it_has(self, next_object):
        request = ReadDeviceIdentification(2)
        more, following = (0, 0) if next_object is None else (0xFF, next_object)
        objects = b"\0\1a" + b"\1\1b" + b"\2\1c" + b"\3\xff"
        full = bytes([43, 14, 2, 2, more, following, 5]) + objects + bytes(235)
        assert len(full) == pdu.MAX_PDU
        page = request.decode_response(full)
        objects_ = {0: b"a", 1: b"b", 2: b"c"}
        assert page == IdentificationPage(2, next_object, objects_, complete=False)
        steps = identify("regular")
        next(steps)
        with pytest.raises(StopIteration) as stop:
            steps.send(page)
        assert stop.value.value == pdu.DeviceIdentification(2, objects_, complete=False)
        for missing in (0, 1, 2):
            steps = identify("regular")
            next(steps)
            rest = {number: value for number, value in objects_.items() if number != missing}
            with pytest.raises(InvalidResponse, match="promised"):
                steps.send(page._replace(objects=rest))

    @each_case("mei_type", [13, 14])
    @each_case("code", [1, 2, 4])
    def test_a_mei_type_in_an_exception_is_not_taken_for_the_code(self, mei_type: int, code: int):
        identification = ReadDeviceIdentification(1)
        request = identification if mei_type == 14 else EncapsulatedTransport(13, b"")
        for tail in (bytes([mei_type, code]), bytes([code, mei_type])):
            with pytest.raises(ExceptionResponse) as caught:
                request.decode_response(b"\xab" + tail)
            assert caught.value.code == code
            assert caught.value.function == 43
        for tail in (bytes([mei_type ^ 3, code]), bytes([code, 0]), bytes([mei_type, code, 0])):
            with pytest.raises(InvalidResponse):
                request.decode_response(b"\xab" + tail)

    def test_an_identification_ends_after_at_most_256_requests(self) -> None:
        """The ids only rise, so no device has a client ask more than 256 times."""
        steps = identify("extended")
        next(steps)
        for number in range(1, 256):
            assert steps.send(IdentificationPage(3, number, {})).object_id == number
        with pytest.raises(InvalidResponse):
            steps.send(IdentificationPage(3, 255, {}))

    @each_case(
        ("level", "error"),
        [
            ("all", ValueError),
            ("", ValueError),
            ("Basic", ValueError),
            (-1, ValueError),
            (256, ValueError),
            (None, TypeError),
            (True, TypeError),
            (1.0, TypeError),
            (b"basic", TypeError),
        ],
        ids=repr,
    )
    def test_level_is_a_name_or_an_object(self, level: Any, error: type[Exception]) -> None:
        with pytest.raises(error, match=r"^level must be"):
            next(identify(level))


def page(*objects: tuple[int, bytes], code: int = 1, more: int = 0, following: int = 0) -> bytes:
    body = b"".join(bytes([number, len(value)]) + value for number, value in objects)
    return bytes([0x2B, 0x0E, code, 0x81, more, following, len(objects)]) + body


def test_objects_have_the_names_of_the_specification() -> None:
    objects = {number: b"%d" % number for number in (*range(1, 8), 128)}
    assert pdu.DeviceIdentification(1, {0: b"c\xff", **objects}).names == {
        "VendorName": "c\ufffd",
        "ProductCode": "1",
        "MajorMinorRevision": "2",
        "VendorUrl": "3",
        "ProductName": "4",
        "ModelName": "5",
        "UserApplicationName": "6",
    }


@each_case(
    ("more", "following", "number"), [(0, 0, None), (0, 5, None), (0xFF, 0, 0), (0xFF, 5, 5)]
)
def test_the_next_object_counts_only_if_more_follow(more, following, number) -> None:
    response = page((0, b"a"), more=more, following=following)
    result = pdu.ReadDeviceIdentification(1).decode_response(response)
    assert result == pdu.IdentificationPage(0x81, number, {0: b"a"})


def test_repeated_or_unrequested_objects_are_refused() -> None:
    with pytest.raises(InvalidResponse, match="object 0 twice"):
        pdu.ReadDeviceIdentification(1).decode_response(page((0, b"a"), (0, b"b")))
    with pytest.raises(InvalidResponse, match=r"objects \[4\]"):
        pdu.ReadDeviceIdentification(4, 5).decode_response(page((4, b"a"), code=4))
    good = pdu.ReadDeviceIdentification(4, 5).decode_response(page((5, b"a"), code=4))
    assert good.objects == {5: b"a"}
