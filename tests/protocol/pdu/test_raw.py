"""
Raw requests, whose data go and come as they are.
"""

from __future__ import annotations

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import IllegalDataAddress
from libmodbus_py.protocol.pdu import RawRequest


class TestRawRequest:
    def test_data_go_and_come_as_they_are(self) -> None:
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

    def test_it_is_no_write_and_is_answered(self) -> None:
        assert RawRequest(6).may_be_broadcast is False
        assert RawRequest(6).expects_response

    def test_it_takes_no_place_in_the_table(self) -> None:
        assert RawRequest not in pdu.REQUESTS.values()
