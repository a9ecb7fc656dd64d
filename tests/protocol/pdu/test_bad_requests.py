"""What a server must answer to bad requests: those of `files/requests.csv`, by function."""

import csv
import re
from pathlib import Path

import pytest

from libmodbus_py import pdu
from libmodbus_py.protocol.errors import ExceptionResponse, IllegalFunction
from libmodbus_py.protocol.pdu import WriteCoils, decode_request
from tests.support.cases import each_case

ROWS = list(csv.reader((Path(__file__).parent / "files/requests.csv").read_text().splitlines()))[1:]


def decoded(text: str) -> bytes:
    """Return the bytes of a request of the file, where `00*3` and `(01 02)*3` come three times."""
    repetition = re.compile(r"(?:\(([^)]+)\)|(\w\w))\*(\d+)")
    return bytes.fromhex(repetition.sub(lambda m: f"{m[1] or m[2]} " * int(m[3]), text))


class TestBadRequests:
    """Section 6: length and quantity are refused with 3, before addresses with 2."""

    @each_case(("what", "exception", "text"), ROWS)
    def test_a_server_answers_a_bad_request_with_the_exception(self, what, exception, text) -> None:
        request = decoded(text)
        assert request[0] == int(what[:2])
        if not exception:  # at the very limit
            assert decode_request(request).encode() == request
            return
        with pytest.raises(ExceptionResponse) as caught:
            decode_request(request)
        assert type(caught.value).__name__ == exception
        assert caught.value.function == request[0]

    @pytest.mark.parametrize("data", [b"", b"\0\0\0\1"])
    def test_unknown_function_is_illegal_whatever_follows(self, data: bytes) -> None:
        for code in set(range(256)) - set(pdu.REQUESTS):
            with pytest.raises(IllegalFunction) as caught:
                decode_request(bytes([code]) + data)
            assert caught.value.code == 1
            assert caught.value.function == code

    def test_an_empty_pdu_is_a_value_error(self) -> None:
        with pytest.raises(ValueError, match="pdu"):
            decode_request(b"")

    @pytest.mark.parametrize("data", [b"\xff", b"\xf5"])
    def test_unused_bits_of_coils_are_ignored(self, data: bytes) -> None:
        assert decode_request(b"\x0f\0\0\0\3\1" + data) == WriteCoils(
            0, [value == 1 for value in (1, data[0] >> 1 & 1, 1)]
        )
