"""The identification of a device, and CANopen references: function 43."""

from libmodbus_py import Device, Mapping
from libmodbus_py.protocol import errors
from tests.device.devices import identified, new_device, page
from tests.device.test_diagnostics import vector
from tests.support.cases import each_case
from tests.support.golden import Refused

IDENTITY: dict[str | int, str | bytes] = {
    "VendorName": b"v" * 244,
    "ProductCode": "",
    "MajorMinorRevision": "V2.11",
    "VendorUrl": "u" * 244,
    "UserApplicationName": "a" * 230,
    128: b"\0" * 244,
    200: "private",
    255: b"z" * 244,
}
IDENTITY_NUMBERS = (0, 1, 2, 3, 6, 128, 200, 255)


class TestIdentification:
    def test_answer_is_that_of_the_example(self) -> None:
        objects = dict(enumerate(("Company identification", "Product code XX", "V2.11")))
        device = Device(Mapping(), identification=objects)
        answer = bytearray(vector("s1-6.21-rsp"))
        assert answer[3] == 0x01
        answer[3] = 0x81  # the device of the example has no individual access
        assert device.answer(vector("s1-6.21-req")) == answer

    def test_every_device_has_the_mandatory_objects(self) -> None:
        for device in (Device(Mapping()), Device(Mapping(), identification={})):
            identification, sizes = identified(device, "extended")
            assert list(identification.objects) == [0, 1, 2]
            assert all(identification.objects.values())
            assert identification.conformity == 0x81
            assert len(sizes) == 1

    def test_stream_of_large_objects_takes_several_pages(self) -> None:
        device = Device(Mapping(), identification=IDENTITY)
        objects = {
            number: value if isinstance(value, bytes) else value.encode()
            for number, value in zip(IDENTITY_NUMBERS, IDENTITY.values(), strict=True)
        }
        for level, count, pages in (("basic", 3, 2), ("regular", 5, 4), ("extended", 8, 7)):
            identification, sizes = identified(device, level)
            assert list(identification.objects.items()) == list(objects.items())[:count]
            assert identification.conformity == 0x83
            assert len(sizes) == pages
            assert max(sizes) == 253
            assert sizes[0] == 253

    @each_case(
        ("objects", "conformity"),
        [
            ({}, 0x81),
            ({"VendorName": "x"}, 0x81),
            ({"VendorUrl": "x"}, 0x82),
            ({6: ""}, 0x82),
            ({128: b""}, 0x83),
            ({3: "x", 255: "y"}, 0x83),
        ],
        ids=str,
    )
    def test_the_conformity_level_follows_from_the_objects(self, objects, conformity) -> None:
        """Whatever code is requested; the response repeats the requested code."""
        device = Device(Mapping(), identification=objects)
        for code in (1, 2, 3, 4):
            assert device.answer(page(code))[:4] == bytes([0x2B, 0x0E, code, conformity])

    def test_single_objects_are_returned_alone(self) -> None:
        device = Device(Mapping(), identification=IDENTITY)
        whole = identified(device, "extended")[0].objects
        for number in IDENTITY_NUMBERS:
            answer = device.answer(page(4, number))
            value = whole[number]
            head = bytes([0x2B, 0x0E, 4, 0x83, 0, 0, 1, number, len(value)])
            assert answer == head + value
            assert identified(device, number)[0].objects == {number: value}

    def test_unknown_single_object_is_an_illegal_address(self) -> None:
        device = Device(Mapping(), identification=IDENTITY)
        for number in set(range(256)) - set(IDENTITY_NUMBERS):
            assert device.answer(page(4, number)) == b"\xab\2"

    def test_invalid_objects_are_refused(self, refused: Refused) -> None:
        refused("wrong_objects.txt", lambda objects: Device(Mapping(), identification=objects))


class TestCanopen:
    def test_canopen_without_a_function_is_illegal(self) -> None:
        for body in (b"", b"\1\2\3"):
            assert new_device().answer(b"\x2b\x0d" + body) == b"\xab\1"

    def test_canopen_data_are_passed_both_ways(self) -> None:
        data_: list[bytes] = []

        def bus(data: bytes) -> bytes:
            data_.append(data)
            return data[::-1]

        device = Device(Mapping(), canopen=bus)
        for data in (b"", b"\1\2\3", bytes(range(251))):
            assert device.answer(b"\x2b\x0d" + data) == b"\x2b\x0d" + data[::-1]
        assert data_ == [b"", b"\1\2\3", bytes(range(251))]

    def test_a_canopen_function_may_refuse(self) -> None:
        def bus(data: bytes) -> bytes:
            raise errors.ServerDeviceBusy

        assert Device(Mapping(), canopen=bus).answer(b"\x2b\x0d") == b"\xab\6"

    @each_case("bad", [None, "text", 5, bytes(252), bytes(1000)], ids=type)
    def test_canopen_data_that_fit_no_answer_are_a_failure(self, bad, caplog) -> None:
        caplog.clear()
        device = Device(Mapping(), canopen=lambda data: bad)
        for _ in range(2):
            assert device.answer(b"\x2b\x0d") == b"\xab\4"
        assert len(caplog.records) == 1
