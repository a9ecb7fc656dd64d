"""
What a `Traced` says of its ADU.
"""

from __future__ import annotations

import pytest

from libmodbus_py.ports.schemes import SCHEMES
from libmodbus_py.ports.trace import Traced
from tests.support.cases import each_case
from tests.support.talk import ascii_frame, rtu

# The example of function 3 in the application protocol, 6.3: registers 108..110 are read.
PDU = bytes.fromhex("03 006B 0003")
MBAP = bytes.fromhex("1501 0000 0006 11") + PDU

ADUS = {
    "tcp": MBAP,
    "tls": MBAP,
    "udp": MBAP,
    "rtu": rtu("11 03 006B 0003"),
    "rtu+tcp": rtu("11 03 006B 0003"),
    "rtu+udp": rtu("11 03 006B 0003"),
    "ascii": ascii_frame("11 03 006B 0003"),
    "ascii+tcp": ascii_frame("11 03 006B 0003")[:-1] + b";",
}

PLACES = {"rtu": "/dev/ttyS0?baudrate=9600", "ascii": "/dev/ttyS0"}


def traced(scheme: str, adu: bytes, unit: int | None, function: int | None) -> Traced:
    url = f"{scheme}://{PLACES.get(scheme, '[::1]:502')}"
    return Traced(0.0, url, "received", adu, unit, function)


def test_every_scheme_is_here() -> None:
    assert ADUS.keys() == SCHEMES.keys()


@each_case(("scheme", "adu"), ADUS.items())
def test_the_pdu_of_an_adu(scheme: str, adu: bytes) -> None:
    assert traced(scheme, adu, 0x11, 3).pdu == PDU


@each_case("scheme", ["tcp", "tls", "udp"])
def test_an_mbap_header_has_a_transaction(scheme: str) -> None:
    assert traced(scheme, ADUS[scheme], 0x11, 3).transaction == 0x1501


@each_case("scheme", ["rtu", "rtu+tcp", "rtu+udp", "ascii", "ascii+tcp"])
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
