"""What all transports have in common: their names, traces, and what a fork leaves."""

import os
from pathlib import Path
from typing import get_args

import pytest

from libmodbus_py import Client
from libmodbus_py.cli.arguments import SCHEMES_OF_URLS, URLS
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.ports.port import abandoned_in_children, port_class
from libmodbus_py.ports.schemes import SCHEMES, TRANSPORTS, Scheme, Transport, shape_of
from libmodbus_py.ports.trace import TracedFrame
from tests.support.cases import each_case
from tests.support.certificates import Pki
from tests.support.driver import ascii_frame, rtu
from tests.support.urls import rules_of, url_for

KNOWN: dict[Scheme, set[str]] = {
    "tcp": {"has_transactions"},
    "rtu+tcp": set(),
    "ascii+tcp": set(),
    "udp": {"has_transactions", "is_datagram"},
    "rtu+udp": {"is_datagram"},
    "tls": {"has_transactions", "is_secure"},
    "rtu": {"has_path", "is_serial"},
    "ascii": {"has_path", "is_serial"},
}
"""
Scheme -> which of `PROPERTIES` its endpoints have.

These may not change; of other schemes their own tests tell it.
"""

URLS_PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "read-and-write.md"

PROPERTIES = ["has_path", "has_transactions", "is_datagram", "is_secure", "is_serial"]


def test_each_transport_has_a_port_an_endpoint_and_a_scheme() -> None:
    assert set(TRANSPORTS) == set(get_args(Transport))
    assert {transport for _, transport in SCHEMES.values()} == set(TRANSPORTS)
    assert set(SCHEMES) == set(get_args(Scheme))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_each_scheme_has_a_port(scheme: Scheme, tmp_path: Path) -> None:
    rules = rules_of(scheme)
    url = url_for(scheme, "127.0.0.1", line="/dev/null")
    security = {"security": Pki(tmp_path).client()} if rules.is_secure else {}
    client = Client(url, **security)
    if scheme in KNOWN:
        assert {name for name in PROPERTIES if getattr(parse(url), name)} == KNOWN[scheme]
    assert type(client._driver._port) is port_class(SCHEMES[scheme][1])


def test_every_scheme_is_in_the_table_of_the_documentation() -> None:
    text = URLS_PAGE.read_text().partition("| URL | endpoint |")[2]
    table = text.partition("\n\n")[0]
    assert [scheme for scheme in SCHEMES if f"`{scheme}://" not in table] == []


@pytest.mark.parametrize("scheme", SCHEMES)
def test_help_texts_name_every_scheme(scheme: Scheme) -> None:
    assert f" {scheme}://" in SCHEMES_OF_URLS
    assert f" {shape_of(scheme)}" in URLS
    assert max(map(len, f"{SCHEMES_OF_URLS}\n{URLS}".splitlines())) <= 79


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


def traced(scheme: str, adu: bytes, unit: int | None, function: int | None) -> TracedFrame:
    url = url_for(scheme, "[::1]:502", line="/dev/ttyS0?baudrate=9600")
    return TracedFrame(0.0, url, "received", adu, unit, function)


@each_case(("scheme", "adu"), ADUS.items())
def test_a_traced_frame_has_the_pdu_of_its_adu(scheme: str, adu: bytes) -> None:
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
def test_bytes_that_are_no_frame_have_no_pdu_and_no_transaction(scheme: str) -> None:
    each = traced(scheme, b":\x11", None, None)
    assert (each.pdu, each.transaction) == (b"", None)


def test_a_traced_frame_is_a_tuple_of_seven() -> None:
    each = TracedFrame(1.5, "tcp://h:502", "sent", MBAP, 17, 3, "192.0.2.7:51234")
    assert tuple(each) == (1.5, "tcp://h:502", "sent", MBAP, 17, 3, "192.0.2.7:51234")
    assert str(each) == f"tcp://h:502 192.0.2.7:51234 > unit 17, function 3: {MBAP.hex(' ')}"


def test_an_unknown_scheme_is_refused() -> None:
    with pytest.raises(KeyError, match="http"):
        _ = TracedFrame(0.0, "http://h", "sent", MBAP, 17, 3).pdu


pytestmark = [
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork"),
    pytest.mark.filterwarnings("ignore:This process:DeprecationWarning"),
]


class Owner:
    """Counts how often it was abandoned in this process."""

    def __init__(self, error: Exception | None = None) -> None:
        self.times = 0
        self._error = error

    def abandon(self) -> None:
        self.times += 1
        if self._error:
            raise self._error


def times_in_a_child(*owners: Owner) -> list[int]:
    """Return how often a forked child has abandoned each owner."""
    read_end, write_end = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(write_end, bytes(owner.times for owner in owners))
        os._exit(0)
    os.close(write_end)
    os.waitpid(child, 0)
    with os.fdopen(read_end, "rb") as counts:
        return list(counts.read())


def test_a_child_abandons_each_owner_once() -> None:
    owners = Owner(), Owner()
    for owner in owners:
        abandoned_in_children(owner)
    assert times_in_a_child(*owners) == [1, 1]
    assert [owner.times for owner in owners] == [0, 0]
    assert times_in_a_child(*owners) == [1, 1]


def test_an_owner_that_fails_does_not_keep_other_owners_from_being_abandoned() -> None:
    owners = Owner(), Owner(OSError("fails")), Owner()
    for owner in owners:
        abandoned_in_children(owner)
    assert times_in_a_child(*owners) == [1, 1, 1]
