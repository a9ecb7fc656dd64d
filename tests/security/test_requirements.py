"""The requirements of Modbus Security: key exchange, and the state of a tunnel."""

import random
import re
import ssl
from collections import Counter
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.security.tunnel import Records
from libmodbus_py.tools.testing.wires import TcpWire
from tests.support.certificates import Pki
from tests.support.clients import ALL, asking

PAGE = Path(__file__).parents[2] / "docs" / "security.md"

# R-01 to R-67 (v36: chapters 6 to 10).
LAST = 67

P256 = 23  # RFC 8422, 5.1.1
SUPPORTED_GROUPS, EC_POINT_FORMATS = 10, 11
NULL_COMPRESSION = b"\0"


def rows() -> list[str]:
    """Return the rows of the table of requirements."""
    text = PAGE.read_text().partition("## Decisions in the server")[0]
    return re.findall(r"^\| (R-.*)$", text, re.MULTILINE)


def test_each_requirement_has_one_row() -> None:
    counts = Counter(
        number for row in rows() for number in re.findall(r"R-(\d+)", row.split(" | ")[0])
    )
    assert counts == Counter(f"{number:02}" for number in range(1, LAST + 1))


def test_each_row_states_whether_and_how_it_is_met() -> None:
    for row in rows():
        _, state, how = (cell.strip() for cell in row.rstrip("|").split("|", 2))
        assert state in ("met", "not met", "users", "servers", "-"), row
        assert how or "R-31" in row or "R-40" in row, row


class Hello:
    """The ClientHello in the first bytes of a client (RFC 5246, 7.4.1.2)."""

    def __init__(self, record: bytes) -> None:
        self._rest = record[5 + 4 + 2 + 32 :]
        self._take(1)
        suites = self._take(2)
        self.suites = {bytes(suites[at : at + 2]) for at in range(0, len(suites), 2)}
        self.compressions = self._take(1)
        self._rest = self._take(2)
        self.extensions: dict[int, bytes] = {}
        while self._rest:
            kind, self._rest = int.from_bytes(self._rest[:2]), self._rest[2:]
            self.extensions[kind] = self._take(2)

    def _take(self, digits: int) -> bytes:
        size = int.from_bytes(self._rest[:digits])
        part, self._rest = self._rest[digits : digits + size], self._rest[digits + size :]
        assert len(part) == size
        return part


@pytest.fixture
def hello(pki: Pki) -> Hello:
    tunnel = pki.client().to_server("127.0.0.1")
    assert not tunnel.handshake()
    return Hello(tunnel.outgoing())


def test_clients_offer_the_suites_curves_and_points_that_are_required(hello: Hello) -> None:
    assert {b"\xc0\x2f", b"\xc0\x2b"} <= hello.suites
    groups = hello.extensions[SUPPORTED_GROUPS][2:]
    assert P256 in [int.from_bytes(groups[at : at + 2]) for at in range(0, len(groups), 2)]
    assert hello.extensions[EC_POINT_FORMATS][0] > 0
    assert hello.compressions == NULL_COMPRESSION


def test_no_suite_is_without_encryption_or_with_an_old_hash(hello: Hello) -> None:
    """R-36, R-37, R-48, R-50 to R-55."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.set_ciphers("ALL:eNULL:@SECLEVEL=0")
    ciphers = {get_cipher["id"] & 0xFFFF: get_cipher for get_cipher in context.get_ciphers()}
    for suite in hello.suites - {b"\x00\xff"}:  # the indication of renegotiation
        properties = ciphers[int.from_bytes(suite)]
        assert properties["aead"], properties
        assert properties["strength_bits"] >= 128, properties
    assert b"\x00\xff" in hello.suites or 0xFF01 in hello.extensions


HANDSHAKE, SERVER_HELLO, KEY_SHARE = 22, 2, 51

# IANA's registry of TLS Supported Groups.
X25519, X25519MLKEM768 = 29, 4588


def named_group(flight: bytes) -> int:
    """Return the group that a server chose, from its first record (RFC 8446, 4.1.3 and 4.2.8)."""
    assert (flight[0], flight[5]) == (HANDSHAKE, SERVER_HELLO)
    at = 5 + 4 + 2 + 32  # record, handshake, version, random
    at += 1 + flight[at]  # session
    at += 2 + 1  # cipher suite, compression
    end = at + 2 + int.from_bytes(flight[at : at + 2])
    at += 2
    while at < end:
        kind, size = (int.from_bytes(flight[at + skip : at + skip + 2]) for skip in (0, 2))
        if kind == KEY_SHARE:
            return int.from_bytes(flight[at + 4 : at + 6])
        at += 4 + size
    raise AssertionError("a ServerHello without a key share")


@ALL
def test_both_ends_agree_on_the_best_group_of_their_openssl(kind: str, pki: Pki) -> None:
    server = Server(Device(Mapping(holding_registers={0: [7]})), security=pki.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        TcpWire(parse(running.urls[0]).port) as wire,
    ):
        url = f"tls://127.0.0.1:{wire.port}"
        with asking(kind, url, security=pki.client()) as client:
            assert client.read_holding_registers(0, 1) == [7]
        flight = wire.sent_by("server")
    has_hybrid = ssl.OPENSSL_VERSION_INFO >= (3, 5)
    assert named_group(flight) == (X25519MLKEM768 if has_hybrid else X25519)


def record(size: int, kind: int = 23) -> bytes:
    return bytes([kind, 3, 3]) + size.to_bytes(2, "big") + bytes(size)


def is_midway(stream: bytes) -> bool:
    """Walk over all of a stream from its beginning."""
    while stream:
        size = 5 + int.from_bytes(stream[3:5], "big") if len(stream) >= 5 else 5
        if len(stream) < size:
            return True
        stream = stream[size:]
    return False


@pytest.mark.parametrize("size", [0, 1, 255, 256, 0x4100])
def test_a_whole_record_is_recognized(size: int) -> None:
    records = Records()
    assert records.follow(record(size))
    assert not records.is_midway
    assert records.follow(record(size))


@pytest.mark.parametrize(
    "data",
    [b"", record(3)[:4], record(3)[:5], record(3)[:-1], record(3) + b"\x17", record(3) + record(4)],
    ids=["nothing", "half a header", "a header", "a byte less", "a byte more", "two records"],
)
def test_other_bytes_are_not_taken_for_one_record(data: bytes) -> None:
    records = Records()
    assert not records.follow(data)
    assert records.is_midway == is_midway(data)


def test_bytes_like_a_record_within_another_one_are_no_record() -> None:
    records = Records()
    records.follow(record(40)[:10])
    assert not records.follow(record(3))
    assert records.is_midway


@pytest.mark.parametrize("seed", range(20))
def test_each_piece_shows_whether_a_record_is_incomplete(seed: int) -> None:
    chance = random.Random(seed)
    sizes = [chance.choice([0, 1, 2, 5, 9, 260, 700]) for _ in range(60)]
    stream = b"".join(map(record, sizes))
    records, at = Records(), 0
    while at < len(stream):
        size = chance.choice([1, 2, 3, 4, 5, 6, 7, 14, 300, 1000])
        records.follow(stream[at : at + size])
        at += size
        assert records.is_midway == is_midway(stream[:at]), at
