"""
What a `Traced` says of its ADU.
"""

import pytest

from libmodbus_py.ports.schemes import SCHEMES
from libmodbus_py.ports.trace import Traced
from tests.support.cases import each_case
from tests.support.talk import ascii_frame, rtu
from tests.support.urls import url_for

# The example of function 3 in the application protocol, 6.3: registers 108..110 are read.
PDU = bytes.fromhex("03 006B 0003")
MBAP = bytes.fromhex("1501 0000 0006 11") + PDU

FRAMES = {
    "tcp": MBAP,
    "udp": MBAP,
    "rtu": rtu("11 03 006B 0003"),
    "ascii": ascii_frame("11 03 006B 0003"),
}
"""Framing -> a frame with this PDU."""

ADUS: dict[str, bytes] = {
    scheme: FRAMES[framing] for scheme, (framing, _transport) in SCHEMES.items()
}

WITH_IDS = [scheme for scheme, adu in ADUS.items() if adu == MBAP]


def traced(scheme: str, adu: bytes, unit: int | None, function: int | None) -> Traced:
    url = url_for(scheme, "[::1]:502", line="/dev/ttyS0?baudrate=9600")
    return Traced(0.0, url, "received", adu, unit, function)


@each_case(("scheme", "adu"), ADUS.items())
def test_the_pdu_of_an_adu(scheme: str, adu: bytes) -> None:
    assert traced(scheme, adu, 0x11, 3).pdu == PDU


def test_another_delimiter_is_no_part_of_the_pdu() -> None:
    assert traced("ascii+tcp", FRAMES["ascii"][:-1] + b";", 0x11, 3).pdu == PDU


@each_case("scheme", WITH_IDS)
def test_an_mbap_header_has_a_transaction(scheme: str) -> None:
    assert traced(scheme, ADUS[scheme], 0x11, 3).transaction == 0x1501


@each_case("scheme", ADUS.keys() - set(WITH_IDS))
def test_frames_of_lines_have_no_transaction(scheme: str) -> None:
    assert traced(scheme, ADUS[scheme], 0x11, 3).transaction is None


@each_case("scheme", ADUS)
def test_bytes_that_are_no_frame_have_neither(scheme: str) -> None:
    each = traced(scheme, b":\x11", None, None)
    assert (each.pdu, each.transaction) == (b"", None)


def test_it_is_the_tuple_it_was() -> None:
    each = Traced(1.5, "tcp://h:502", "sent", MBAP, 17, 3, "192.0.2.7:51234")
    assert tuple(each) == (1.5, "tcp://h:502", "sent", MBAP, 17, 3, "192.0.2.7:51234")
    assert str(each) == f"tcp://h:502 192.0.2.7:51234 > unit 17, function 3: {MBAP.hex(' ')}"


def test_an_unknown_scheme_is_refused() -> None:
    with pytest.raises(KeyError, match="http"):
        _ = Traced(0.0, "http://h", "sent", MBAP, 17, 3).pdu
