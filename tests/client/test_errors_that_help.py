"""The usual mistakes, each said in the one line of the error that it leads to."""

import errno
import re
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError, ModbusError
from libmodbus_py.client.outcomes import explain, explain_end
from tests.support.cases import each_case
from tests.support.clients import ALL, World, asking, read
from tests.support.peers import FakeServer, answering, mbap
from tests.support.talk import Talk, ascii_frame, rtu, tcp

NOISE = bytes(range(0x70, 0xF0))

IN_RTU, IN_ASCII, IN_TCP = (
    rtu("01 03 02 000A"),
    ascii_frame("01 03 02 000A"),
    bytes.fromhex("0001 0000 0005 01 03 02 00AA"),
)

# What is spoken -> the URL's scheme, what comes back, and what the error says.
MISTAKES: dict[str, tuple[str, Callable[[bytes], bytes], str]] = {
    "another id": (
        "tcp",
        lambda request: mbap(request, b"\x03\x02\x00\x01", transaction=0x4321),
        r": id 17185, not \d+",
    ),
    "another unit": (
        "tcp",
        lambda request: mbap(request, b"\x03\x02\x00\x01", unit=9),
        r'unit 9 answered; accept_unit="any" would take it',
    ),
    "echo on rtu": ("rtu", lambda request: request, r"request itself came back; echo=True\?"),
    "echo on ascii": ("ascii", lambda request: request, r"request itself came back; echo=True\?"),
    "ascii on rtu": ("rtu", lambda _: IN_ASCII, "this looks like ascii://"),
    "rtu on ascii": ("ascii", lambda _: IN_RTU, "this looks like rtu://"),
    "ascii over tcp": ("rtu+tcp", lambda _: IN_ASCII, r"this looks like ascii\+tcp://"),
    "mbap on rtu over tcp": ("rtu+tcp", lambda _: IN_TCP, "this looks like tcp://"),
    "rtu over tcp on tcp": ("tcp", lambda _: IN_RTU, r"this looks like rtu\+tcp://"),
    "noise": ("rtu", lambda _: NOISE, "only noise; baud rate, parity, A and B swapped"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_recognised_in_one_line(mistake: str, world: World) -> None:
    scheme, came, said = MISTAKES[mistake]
    peer = world.peer(scheme, answering(lambda request: [came(request)]))
    with world.connect(peer.url, timeout=0.15) as client:
        caught = failure(client)
    text = str(caught)
    assert re.search(said, text), text
    assert "\n" not in text
    assert longest_hex(text) <= 32
    assert len(text) < 300
    assert caught.endpoint == peer.url
    assert caught.received


def failure(client: Any) -> ModbusError:
    with pytest.raises(ModbusError) as caught:
        read(client, 1)
    return caught.value


def longest_hex(text: str) -> int:
    runs = re.findall(r"(?:\b[0-9a-f]{2}\b ?)+", text)
    return max((len(run.split()) for run in runs), default=0)


def test_a_client_and_its_errors_say_where_they_lead() -> None:
    client = AsyncClient("tcp://192.0.2.1:502?unit=7")
    assert repr(client) == "<AsyncClient tcp://192.0.2.1:502, unit 7, disconnected>"


ALERT = bytes.fromhex("15 0303 0002 0246")  # RFC 8446, 5.1 and 6: protocol_version, fatal


@ALL
@pytest.mark.parametrize(
    ("answer", "error", "said"),
    [
        (lambda _: [ALERT], ModbusError, "like tls://"),
        (None, ModbusConnectionError, r"nothing was answered yet; .* tls://"),
    ],
    ids=["an alert", "an end"],
)
def test_a_server_that_wants_tls_is_recognised(kind: str, answer, error, said) -> None:
    with (
        FakeServer(answer) as server,
        asking(kind, server.url, timeout=5) as plc,
        pytest.raises(error, match=said),
    ):
        plc.read_coils(0, 1)


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


@each_case(
    ("scheme", "received", "hint"),
    [
        ("rtu", "ascii", "this looks like ascii://"),
        ("ascii", "rtu", "this looks like rtu://"),
        ("rtu", "tcp", "this looks like tcp://"),
        ("rtu+tcp", "tcp", "this looks like tcp://"),
        ("ascii+tcp", "tcp", "this looks like tcp://"),
        ("tcp", "rtu", "this looks like rtu+tcp://"),
        ("tcp", "ascii", "this looks like ascii+tcp://"),
        ("rtu+tcp", "ascii", "this looks like ascii+tcp://"),
        ("udp", "rtu", ""),
        ("rtu", "rtu", ""),
        ("ascii", "ascii", ""),
        *((scheme, "tcp", "") for scheme in ("tcp", "tls", "unix")),
    ],
)
def test_another_framing_is_recognised(scheme: str, received: str, hint: str) -> None:
    sent = SENT.get(scheme.removesuffix("+tcp"), SENT["tcp"])
    assert explain(scheme, sent, RECEIVED[received]) == hint


@each_case("scheme", ["rtu", "ascii", "rtu+tcp", "ascii+tcp"])
def test_the_request_that_came_back_is_recognised(scheme: str) -> None:
    sent = SENT[scheme.removesuffix("+tcp")]
    assert explain(scheme, sent, sent) == "the request itself came back; echo=True?"


@each_case(
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


PLAIN = ("tcp", "rtu+tcp", "ascii+tcp")


def frame(length: int, header: str = "0001 0000") -> bytes:
    """A header that announces so many bytes, with them."""
    return bytes.fromhex(header) + length.to_bytes(2, "big") + bytes(length)


@each_case(
    ("received", "is_tls"),
    [
        ("14 03 01 00 01", True),
        ("15 03 03 00 02 02 0A", True),
        ("17 03 04 00 00", True),
        ("13 03 03 00 02", False),
        ("18 03 03 00 02", False),
        ("15 02 03 00 02", False),
        ("15 03 05 00 02", False),
        ("15 03 03 00", False),
    ],
)
def test_a_record_of_tls_has_a_type_and_a_version(received: str, is_tls: bool) -> None:
    for scheme in PLAIN:
        found = explain(scheme, SENT["tcp"], bytes.fromhex(received))
        assert (found == "this looks like tls://") is is_tls
    for scheme in ("tls", "udp"):
        assert explain(scheme, SENT["tcp"], bytes.fromhex(received)) == ""


@each_case(("length", "is_frame"), [(1, False), (2, True), (254, True), (255, False)])
def test_a_frame_of_tcp_has_a_unit_and_a_pdu(length: int, is_frame: bool) -> None:
    found = explain("rtu+tcp", SENT["rtu"], frame(length))
    assert (found == "this looks like tcp://") is is_frame


@each_case("received", [frame(9)[:-1], frame(9) + b"\0", frame(9, "0001 0001"), frame(9)[:5]])
def test_a_header_that_fits_nothing_is_none_of_tcp(received: bytes) -> None:
    assert explain("rtu+tcp", SENT["rtu"], received) == ""


def test_a_frame_of_rtu_has_check_bytes_that_fit_somewhere() -> None:
    looks = "this looks like rtu+tcp://"
    assert explain("tcp", SENT["tcp"], rtu("11 83 02")) == looks
    assert explain("tcp", SENT["tcp"], rtu("11 83 02") + b"\x55" * 9) == looks
    assert explain("tcp", SENT["tcp"], rtu("11" + "07" * 253)) == looks  # 256 bytes
    for received in (rtu("11 03"), rtu("11" + "07" * 254), rtu("11 83 02")[:-1]):
        assert explain("tcp", SENT["tcp"], received) == ""


def test_a_frame_of_ascii_begins_with_a_colon_and_three_bytes() -> None:
    looks = "this looks like ascii+tcp://"
    assert explain("tcp", SENT["tcp"], b":1183aF") == looks
    assert explain("tcp", SENT["tcp"], b"\r\n:1183026A\r\n") == looks
    for received in (b":11830", b":11830x", b"1103026A\r\n"):
        assert explain("tcp", SENT["tcp"], received) == ""


@each_case("received", ["11 03", "00 11 83", "11 83 02"])
def test_bytes_with_unit_and_function_of_the_request_are_no_noise(received: str) -> None:
    assert explain("rtu", SENT["rtu"], bytes.fromhex(received)) == ""


@each_case("received", ["11", "03 11", "12 03", "11 04", "91 03"])
def test_bytes_without_them_are_noise(received: str) -> None:
    noise = "only noise; baud rate, parity, A and B swapped?"
    assert explain("rtu", SENT["rtu"], bytes.fromhex(received)) == noise
    assert explain("rtu+tcp", SENT["rtu"], bytes.fromhex(received)) == ""


def test_who_ends_a_plain_connection_before_an_answer_may_want_tls() -> None:
    told = "nothing was answered yet; does it want tls://?"
    for number in (errno.ECONNRESET, errno.EPIPE):
        assert [explain_end(scheme, number) for scheme in PLAIN] == [told] * 3
        assert [explain_end(scheme, number) for scheme in ("tls", "rtu", "udp")] == [""] * 3
    assert explain_end("tcp", errno.ETIMEDOUT) == explain_end("tcp", None) == ""
