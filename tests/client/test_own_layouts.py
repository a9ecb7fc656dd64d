"""
Devices that answer a function of the specification in a layout of their own, on every transport.
"""

from typing import Any, ClassVar

import pytest

from libmodbus_py import FrameError, IllegalDataAddress, ModbusTimeoutError, pdu
from tests.support.clients import Connect
from tests.support.contexts import context_at
from tests.support.peers import Write, mbap, peer_at
from tests.support.talk import ascii_frame, rtu

# As a frequency inverter answers: the count of bytes has 16 bits (pymodbus#1542).
ANSWER = "03 0002 1781"
REQUEST = bytes.fromhex("7002 0001")
USUAL, USUAL_ANSWER = "03 0005 0001", "03 02 0007"
REFUSED, REFUSAL = "03 0009 0001", "83 02"


class WideCount(pdu.Request[bytes]):
    """Function 3, whose answers have such a count; the program does not register it."""

    function: ClassVar[int] = 3
    request_length = pdu.fixed(5)
    response_length: ClassVar[Any] = staticmethod(
        lambda head: 3 + int.from_bytes(head[1:3], "big") if len(head) > 2 else None
    )

    def encode(self) -> bytes:
        return b"\x03" + REQUEST

    def _decode_response(self, data: bytes) -> bytes:
        return data[3:]


def device(scheme: str, pieces: int = 1) -> Any:
    def on_request(request: bytes, write: Write) -> None:
        text = bytes.fromhex(request[1:-4].decode()) if request.startswith(b":") else request
        usual, refused = bytes.fromhex(USUAL), bytes.fromhex(REFUSED)
        body = USUAL_ANSWER if usual in text else REFUSAL if refused in text else ANSWER
        if scheme == "tcp":
            frame = mbap(request, bytes.fromhex(body))
        else:
            frame = (ascii_frame if scheme.startswith("ascii") else rtu)("01" + body)
        size = -(-len(frame) // pieces)
        for at in range(0, len(frame), size):
            write(frame[at : at + size])

    return peer_at(scheme, on_request)


SCHEMES = ["rtu", "rtu+tcp", "rtu+udp", "ascii", "ascii+tcp", "tcp"]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("pieces", [1, 3])
def test_answers_in_an_own_layout_are_taken(connect: Connect, scheme: str, pieces: int) -> None:
    pieces = 1 if scheme == "rtu+udp" else pieces
    with device(scheme, pieces) as peer, connect(peer.url, unit=1, timeout=2) as client:
        check(client)


@pytest.mark.parametrize("scheme", ["rtu", "tcp"])
def test_contexts_take_answers_in_an_own_layout(scheme: str) -> None:
    with device(scheme) as peer, context_at(peer.url, unit=1, timeout=2) as context:
        check(context)


def check(client: Any) -> None:
    """The usual layout before, between and behind."""
    for _ in range(2):
        assert client.read_holding_registers(5, 1) == [7]
        assert client.execute(pdu.RawRequest(3, REQUEST)) == bytes.fromhex("0002 1781")
        assert client.execute(pdu.RawRequest(3, bytes.fromhex(USUAL)[1:])) == b"\2\0\7"
        assert client.execute(WideCount()) == bytes.fromhex("1781")
        with pytest.raises(IllegalDataAddress):
            client.execute(pdu.RawRequest(3, bytes.fromhex(REFUSED)[1:]))


def test_a_damaged_answer_in_an_own_layout_is_none(connect: Connect) -> None:
    damaged = rtu("01" + ANSWER)[:-1] + b"\0"
    with (
        peer_at("rtu", lambda request, write: write(damaged)) as peer,
        connect(peer.url, unit=1, timeout=0.2) as client,
        pytest.raises((ModbusTimeoutError, FrameError)),
    ):
        client.execute(pdu.RawRequest(3, REQUEST))
