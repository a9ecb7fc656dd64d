"""
Answers that are for somebody else: another unit, another function, another transaction id.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from libmodbus_py import ModbusError
from libmodbus_py.protocol.framing import crc16
from tests.support.clients import making
from tests.support.peers import answering, echo, mbap

Answer = Callable[[bytes], bytes]


def rtu(*body: int) -> Answer:
    frame = bytes(body)
    return lambda request: frame + crc16(frame).to_bytes(2, "little")


TCP: dict[str, tuple[Answer, bool]] = {
    "unit": (lambda request: echo(request, unit=9), True),
    "id": (lambda request: echo(request, transaction=request[1] + 7), True),
    "function": (lambda request: mbap(request, b"\x04\x02\0\7"), True),
    "refusal of another function": (lambda request: mbap(request, b"\x84\x02"), True),
    "its own refusal": (lambda request: mbap(request, b"\x83\x02"), False),
    "too much for a refusal": (lambda request: mbap(request, b"\x83\x02\x02"), False),
    "too short": (lambda request: mbap(request, b"\x03\x02\0"), False),
    "no answer": (lambda request: b"", False),
}

RTU: dict[str, tuple[Answer, bool]] = {
    "unit": (rtu(9, 3, 2, 0, 7), True),
    "function": (rtu(1, 4, 2, 0, 7), True),
    "too much": (rtu(1, 3, 4, 0, 7, 0, 7), False),
}


def failure(scheme: str, answer: Answer) -> ModbusError:
    """Return what a request meets that is answered so; the client's kind has no part in it."""
    with making("python") as world:
        peer = world.peer(scheme, answering(lambda request: [answer(request)]))
        with world.connect(peer.url, timeout=0.2) as plc, pytest.raises(ModbusError) as caught:
            plc.read_holding_registers(7, 1)
    return caught.value


@pytest.mark.parametrize(("answer", "is_so"), TCP.values(), ids=TCP)
def test_error_says_whether_it_answers_another_request(answer: Answer, is_so: bool) -> None:
    assert failure("tcp", answer).answers_another is is_so


@pytest.mark.parametrize(("answer", "is_so"), RTU.values(), ids=RTU)
def test_error_says_so_on_lines(answer: Answer, is_so: bool) -> None:
    assert failure("rtu", answer).answers_another is is_so
