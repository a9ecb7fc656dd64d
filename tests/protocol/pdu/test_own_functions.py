"""Functions of one's own, registered with the package; raw requests; and reads of one's own."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import InvalidResponse, pdu
from libmodbus_py.protocol.errors import (
    IllegalDataAddress,
    IllegalDataValue,
    IllegalFunction,
    MemoryParityError,
    ServerDeviceFailure,
)
from libmodbus_py.protocol.pdu import RawRequest, Request, decode_request
from libmodbus_py.protocol.plain import plain
from libmodbus_py.tools.page.log import request_words
from tests.protocol.pdu.examples import Doubled
from tests.support.cases import each_case


@pytest.fixture
def doubled() -> Iterator[type[Doubled]]:
    yield pdu.register(Doubled)
    pdu.REQUESTS.pop(Doubled.function)


class Plain(Request[None]):
    """A class that is no dataclass."""

    function = 0x42
    request_length = response_length = pdu.fixed(2)

    def __init__(self, channel: int) -> None:
        self.channel = channel
        self._cached = b""

    def encode(self) -> bytes:
        return bytes([self.function, self.channel])

    @classmethod
    def decode(cls, pdu: bytes) -> Plain:
        return cls(pdu[1])

    def encode_response(self, result: None = None) -> bytes:
        return self.encode()

    def _decode_response(self, pdu: bytes) -> None:
        return None


class Changed(Doubled):
    """Derived from a dataclass, with arguments of its own."""

    def __init__(self) -> None:
        pass


@each_case(
    ("request_", "text", "fields", "words"),
    [
        (Plain(7), "Plain(channel=7)", {"name": "Plain", "channel": 7}, "plain: channel 7"),
        (Changed(), "Changed()", {"name": "Changed"}, "changed"),
    ],
)
def test_a_request_class_that_is_no_dataclass_has_a_repr(request_, text, fields, words) -> None:
    assert str(request_) == text
    assert plain(request_) == fields
    assert request_words(request_) == words
    with pytest.raises(ServerDeviceFailure, match=re.escape(text)):
        request_.decode_response(bytes([request_.function | 0x80, 4]))


class TestRegister:
    def test_a_registered_class_is_used_at_both_ends(self, doubled: type[Doubled]) -> None:
        request = doubled((1, 2))
        assert decode_request(request.encode()) == request
        assert pdu.request_length(b"\x41\4") == pdu.response_length(b"\x41\4") == 6
        response = request.encode_response([1, 1, 2, 2])
        assert request.decode_response(response) == [1, 1, 2, 2]
        assert str(request) == "Doubled(values=(1, 2))"

    def test_errors_of_a_registered_class_are_those_of_any_class(self, doubled: type[Doubled]):
        with pytest.raises(IllegalDataValue):
            decode_request(b"\x41\1\0")
        with pytest.raises(IllegalDataValue):
            decode_request(b"\x41\4\0\0")
        with pytest.raises(MemoryParityError) as caught:
            doubled((1,)).decode_response(b"\xc1\x08")
        assert caught.value.function == 0x41
        for bad in (b"", b"\x41", b"\x41\2\0", b"\x42\2\0\0", b"\xc2\1"):
            with pytest.raises(InvalidResponse):
                doubled((1,)).decode_response(bad)

    def test_a_function_is_unknown_before_and_after_the_registration(self) -> None:
        for _ in range(2):
            with pytest.raises(IllegalFunction):
                decode_request(b"\x41\0")
            assert pdu.register(Doubled) is Doubled  # a decorator returns the class
            assert pdu.register(Doubled) is Doubled  # once more does no harm
            assert decode_request(b"\x41\0") == Doubled(())
            pdu.REQUESTS.pop(0x41)

    def test_a_function_that_is_already_registered_is_refused(self, doubled: type[Doubled]) -> None:
        classes = dict(pdu.REQUESTS)
        for code in pdu.REQUESTS:
            other = type("Other", (Doubled,), {"function": code, "__slots__": ()})
            with pytest.raises(ValueError, match=rf"^Other: function {code} is \w+$"):
                pdu.register(other)
        assert classes == pdu.REQUESTS

    @each_case("code", [0, 128, 255, -1, "65", None])
    def test_the_function_of_a_class_must_be_a_code(self, code: Any) -> None:
        other = type("Other", (Doubled,), {"function": code, "__slots__": ()})
        with pytest.raises(ValueError, match=r"^Other: function must be in 1\.\.127"):
            pdu.register(other)

    def test_class_without_a_function_is_refused(self) -> None:
        for kind in (Request, RawRequest):
            with pytest.raises(ValueError, match="function must be in"):
                pdu.register(kind)

    @each_case("bad", [None, 65, "Doubled", Doubled((1,)), int, Exception], ids=repr)
    def test_only_request_classes_are_accepted(self, bad: Any) -> None:
        with pytest.raises(TypeError, match="derived from Request"):
            pdu.register(bad)

    @each_case("code", [9, 18, 65, 72, 100, 110, 127])
    def test_any_free_code_can_be_registered(self, code: int) -> None:
        other = type("Other", (Doubled,), {"function": code, "__slots__": ()})
        assert pdu.register(other) is other
        try:
            assert type(decode_request(bytes([code, 2, 0, 1]))) is other
        finally:
            pdu.REQUESTS.pop(code)


class TestRawRequest:
    def test_raw_data_are_sent_and_returned_unchanged(self) -> None:
        for function in range(1, 128):
            request = RawRequest(function, b"\0\xff")
            assert request.encode() == bytes([function, 0, 0xFF])
            assert request.decode_response(bytes([function])) == b""
            assert request.decode_response(bytes([function]) + bytes(252)) == bytes(252)
            assert RawRequest.decode(request.encode()) == request
            assert request.encode_response(b"\7") == bytes([function, 7])

    def test_refusals_are_exceptions(self) -> None:
        with pytest.raises(IllegalDataAddress) as caught:
            RawRequest(65, b"\1").decode_response(b"\xc1\2")
        assert caught.value.function == 65
        assert "RawRequest(function=65, data=b'\\x01')" in str(caught.value)


# Application protocol, 6.3: three registers.
RESPONSE = bytes.fromhex("03 06 022B00000064")


class Signed(pdu.ReadHoldingRegisters):
    def _decode_response(self, pdu: bytes) -> list[int]:
        return [entry - 65536 * (entry > 32767) for entry in super()._decode_response(pdu)]


class Padded(pdu.ReadHoldingRegisters):
    """Of a device whose responses are all as long as the longest."""

    response_length = pdu.fixed(12)

    def _decode_response(self, pdu: bytes) -> list[int]:
        return super()._decode_response(pdu[: 2 + pdu[1]])


def test_a_class_decodes_responses_of_the_specified_length() -> None:
    assert Signed(0, 1).decode_response(bytes.fromhex("03 02 FFFE")) == [-2]
    assert Signed(107, 3).decode_response(RESPONSE) == [555, 0, 100]


def test_a_class_with_its_own_length_refuses_the_specified_length() -> None:
    assert Padded(107, 3).decode_response(RESPONSE + bytes(4)) == [555, 0, 100]
    with pytest.raises(InvalidResponse):
        Padded(107, 3).decode_response(RESPONSE)


class Unfinished(Request[None]):
    function = 0x43
    request_length = response_length = pdu.fixed(2)


def test_a_class_without_an_encoder_or_decoder_is_an_error() -> None:
    with pytest.raises(NotImplementedError):
        Unfinished().encode()
    with pytest.raises(NotImplementedError):
        Unfinished.decode(b"\x43\0")
