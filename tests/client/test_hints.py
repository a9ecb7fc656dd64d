"""
What bytes that answer nothing look like. The frames are those of the specifications.
"""

from __future__ import annotations

import errno

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.client.hints import explain
from libmodbus_py.protocol.errors import in_hex
from tests.support.talk import Talk, ascii_frame, rtu, tcp

# Read register 6Bh, three of them, and what is answered (application protocol, 6.3).
PDU = "03 006B 0003"
ANSWER = "03 06 022B 0000 0064"
SENT = {
    "rtu": bytes.fromhex("11 03 006B 0003 7687"),
    "ascii": b":1103006B00037E\r\n",
    "tcp": bytes.fromhex("0001 0000 0006 11 03 006B 0003"),
}
RECEIVED = {
    "rtu": rtu(f"11 {ANSWER}"),
    "ascii": ascii_frame(f"11 {ANSWER}"),
    "tcp": bytes.fromhex(f"0001 0000 0009 11 {ANSWER}"),
}


@pytest.mark.parametrize(
    ("scheme", "received", "hint"),
    [
        ("rtu", "ascii", "this looks like ascii://"),
        ("ascii", "rtu", "this looks like rtu://"),
        ("rtu+tcp", "tcp", "this looks like tcp://"),
        ("ascii+tcp", "tcp", "this looks like tcp://"),
        ("tcp", "rtu", "this looks like rtu+tcp://"),
        ("tcp", "ascii", "this looks like ascii+tcp://"),
        ("rtu+tcp", "ascii", "this looks like ascii+tcp://"),
        ("udp", "rtu", ""),
        ("rtu", "rtu", ""),
        ("tcp", "tcp", ""),
        ("ascii", "ascii", ""),
    ],
)
def test_another_framing_is_recognised(scheme: str, received: str, hint: str) -> None:
    framing = scheme.removesuffix("+tcp").replace("udp", "tcp")
    assert explain(scheme, SENT[framing], RECEIVED[received]) == hint


@pytest.mark.parametrize("length", ["0006", "0106"])
def test_a_header_whose_length_fits_is_that_of_tcp(length: str) -> None:
    received = bytes.fromhex(f"0001 0000 {length} 11 03 006B 0003")
    hint = explain("ascii+tcp", SENT["ascii"], received)
    assert hint == ("this looks like tcp://" if length == "0006" else "")


@pytest.mark.parametrize("scheme", ["rtu", "ascii", "rtu+tcp", "ascii+tcp"])
def test_the_request_that_came_back_is_recognised(scheme: str) -> None:
    sent = SENT[scheme.removesuffix("+tcp")]
    assert explain(scheme, sent, sent) == "the request itself came back; echo=True?"


@pytest.mark.parametrize(
    ("record", "is_tls"),
    [
        ("14 03 00 0001", True),
        ("17 03 04 0001", True),
        ("13 03 03 0001", False),  # no kind of a record
        ("18 03 03 0001", False),
        ("16 02 03 0001", False),  # no version: TLS 1.0 to 1.3 are 3.1 to 3.4
        ("16 03 05 0001", False),
        ("16 03 03 00", False),
    ],
)
def test_a_record_of_tls_is_recognised_by_its_header(record: str, is_tls: bool) -> None:
    assert ("tls://" in explain("tcp", SENT["tcp"], bytes.fromhex(record))) is is_tls


@pytest.mark.parametrize("noise", ["FE", "00 FF 00 FF", "9A C4 F0 70" * 10])
def test_noise_on_a_serial_line_is_recognised(noise: str) -> None:
    hint = explain("rtu", SENT["rtu"], bytes.fromhex(noise))
    assert hint == "only noise; baud rate, parity, A and B swapped?"
    assert explain("rtu+tcp", SENT["rtu"], bytes.fromhex(noise)) == ""


def test_the_start_of_an_answer_is_no_noise() -> None:
    assert explain("rtu", SENT["rtu"], RECEIVED["rtu"][:-1]) == ""
    assert explain("rtu", SENT["rtu"], bytes.fromhex("FF 11 83")) == ""


def test_at_most_32_bytes_are_in_hex() -> None:
    assert in_hex(bytes(32)) == " ".join(["00"] * 32)
    assert in_hex(bytes(33)) == " ".join(["00"] * 32) + " ... (33 bytes)"
    assert len(in_hex(bytes(600))) < 120


@pytest.mark.parametrize(
    ("answered", "asks", "by_itself", "is_told"),
    [
        (False, True, True, True),
        (True, True, True, False),
        (False, False, True, False),
        (False, True, False, False),
    ],
)
def test_tls_is_named_where_a_request_was_answered_by_the_end_of_a_new_connection(
    answered: bool, asks: bool, by_itself: bool, is_told: bool
) -> None:
    talk = Talk()
    if answered:
        talk.ask(1)
        talk.come(tcp(talk.sent[0]))
    if asks:
        talk.ask(2)
    error = ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
    talk.lose(error, by_itself=by_itself)
    assert ("does it want tls://?" in str(error)) is is_told


@pytest.mark.parametrize("scheme", ["tls", "unix"])
def test_a_frame_of_the_framing_in_use_looks_like_no_other_scheme(scheme: str) -> None:
    assert explain(scheme, SENT["tcp"], RECEIVED["tcp"]) == ""
