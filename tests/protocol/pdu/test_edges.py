"""
Lengths, counts and objects at the edges of what the application protocol allows.
"""

from __future__ import annotations

import pytest

from libmodbus_py import InvalidResponse, pdu
from tests.support.cases import each_case

# --- device identification (section 6.21) --------------------------------------------------------


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
    ("more", "following", "expected"), [(0, 0, None), (0, 5, None), (0xFF, 0, 0), (0xFF, 5, 5)]
)
def test_the_next_object_counts_only_if_more_follow(
    more: int, following: int, expected: int | None
) -> None:
    response = page((0, b"a"), more=more, following=following)
    found = pdu.ReadDeviceIdentification(1).decode_response(response)
    assert found == pdu.IdentificationPage(0x81, expected, {0: b"a"})


def test_an_object_that_comes_twice_or_was_not_asked_for_is_refused() -> None:
    with pytest.raises(InvalidResponse, match="object 0 twice"):
        pdu.ReadDeviceIdentification(1).decode_response(page((0, b"a"), (0, b"b")))
    with pytest.raises(InvalidResponse, match=r"objects \[4\]"):
        pdu.ReadDeviceIdentification(4, 5).decode_response(page((4, b"a"), code=4))
    good = pdu.ReadDeviceIdentification(4, 5).decode_response(page((5, b"a"), code=4))
    assert good.objects == {5: b"a"}


def test_a_full_message_may_lack_objects_that_it_promises() -> None:
    """From 244 bytes on there was no room for them; what is too short lacks them for no reason."""
    for size, is_full in ((243, False), (244, True), (253, True)):
        value = bytes(size - 7 - 2)
        response = bytearray(page((0, value)))
        response[6] = 9
        assert len(response) == size
        if is_full:
            found = pdu.ReadDeviceIdentification(1).decode_response(bytes(response))
            assert found == pdu.IdentificationPage(0x81, None, {0: value}, complete=False)
        else:
            with pytest.raises(InvalidResponse, match="243 bytes"):
                pdu.ReadDeviceIdentification(1).decode_response(bytes(response))


def test_bytes_behind_the_objects_of_a_full_message_are_none_of_it() -> None:
    response = page((0, bytes(235)))
    assert pdu.ReadDeviceIdentification(1).decode_response(response).complete
    with pytest.raises(InvalidResponse, match="246 bytes"):
        pdu.ReadDeviceIdentification(1).decode_response(response + b"\0\0")
