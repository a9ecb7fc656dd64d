"""The usual mistakes, each named in the one line of its error."""

import errno
import re
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError, ModbusError
from libmodbus_py.client.outcomes import explain
from tests.support.cases import each_case
from tests.support.clients import ALL, World, asking, read
from tests.support.driver import Driver, ascii_frame, rtu, tcp
from tests.support.peers import FakeServer, answering, mbap

NOISE = bytes(range(0x70, 0xF0))

IN_RTU, IN_ASCII, IN_TCP = (
    rtu("01 03 02 000A"),
    ascii_frame("01 03 02 000A"),
    bytes.fromhex("0001 0000 0005 01 03 02 00AA"),
)

# The protocol of the peer -> the URL's scheme, the peer's answer, and the text of the error.
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
    "rtu over udp on udp": ("udp", lambda _: IN_RTU, r"this looks like rtu\+udp://"),
    "mbap on rtu over udp": ("rtu+udp", lambda _: IN_TCP, "this looks like udp://"),
    "rtu over tcp on tcp": ("tcp", lambda _: IN_RTU, r"this looks like rtu\+tcp://"),
    "noise": ("rtu", lambda _: NOISE, "only noise; baud rate, parity, A and B swapped"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_recognised_in_one_line(mistake: str, world: World) -> None:
    scheme, answer_to, message = MISTAKES[mistake]
    peer = world.peer(scheme, answering(lambda request: [answer_to(request)]))
    with world.connect(peer.url, timeout=0.15) as client:
        caught = failure(client)
    text = str(caught)
    assert re.search(message, text), text
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


def test_a_client_and_its_errors_name_the_endpoint() -> None:
    client = AsyncClient("tcp://192.0.2.1:502?unit=7")
    assert repr(client) == "<AsyncClient tcp://192.0.2.1:502, unit 7, disconnected>"


ALERT = bytes.fromhex("15 0303 0002 0246")  # RFC 8446, 5.1 and 6: protocol_version, fatal


@ALL
@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (lambda _: [ALERT], ModbusError, "like tls://"),
        (None, ModbusConnectionError, r"nothing was answered yet; .* tls://"),
    ],
    ids=["an alert", "an end"],
)
def test_a_server_that_wants_tls_is_recognised(kind: str, answer, error, message) -> None:
    with (
        FakeServer(answer) as server,
        asking(kind, server.url, timeout=5) as plc,
        pytest.raises(error, match=message),
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
        ("udp", "rtu", "this looks like rtu+udp://"),
        ("rtu", "rtu", ""),
        ("ascii", "ascii", ""),
        *((scheme, "tcp", "") for scheme in ("tcp", "tls", "unix")),
    ],
)
def test_another_framing_is_recognised(scheme: str, received: str, hint: str) -> None:
    request = SENT.get(scheme.removesuffix("+tcp"), SENT["tcp"])
    assert explain(scheme, request, RECEIVED[received]) == hint


@each_case(
    ("is_answered", "asks", "by_itself", "is_told"),
    [
        (False, True, True, True),
        (True, True, True, False),
        (False, False, True, False),
        (False, True, False, False),
    ],
)
def test_tls_is_named_where_a_request_was_answered_by_the_end_of_a_new_connection(
    is_answered: bool, asks: bool, by_itself: bool, is_told: bool
) -> None:
    driver = Driver()
    if is_answered:
        driver.ask(1)
        driver.come(tcp(driver.sent[0]))
    if asks:
        driver.ask(2)
    error = ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
    driver.lose(error, by_itself=by_itself)
    assert ("does it want tls://?" in str(error)) is is_told


def test_tls_is_not_named_where_an_earlier_connection_was_answered() -> None:
    driver = Driver()
    driver.ask(1)
    driver.come(tcp(driver.sent[0]))
    driver.reconnect()
    driver.ask(2)
    error = ModbusConnectionError("closed by the other side", errno=errno.ECONNRESET)
    driver.lose(error)
    assert str(error) == "closed by the other side"
