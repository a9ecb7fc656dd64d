"""
The requirements of MB-TCP-Security-v36: each has its row in docs/security.md; what clients offer.
"""

import re
import ssl
from collections import Counter
from pathlib import Path

import pytest

from tests.support.certificates import Papers

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


def test_each_number_has_one_row() -> None:
    named = Counter(
        number for row in rows() for number in re.findall(r"R-(\d+)", row.split(" | ")[0])
    )
    assert named == Counter(f"{number:02}" for number in range(1, LAST + 1))


def test_each_row_says_whether_and_how() -> None:
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
        taken, self._rest = self._rest[digits : digits + size], self._rest[digits + size :]
        assert len(taken) == size
        return taken


@pytest.fixture
def hello(papers: Papers) -> Hello:
    tunnel = papers.client().to_server("127.0.0.1")
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
    known = {each["id"] & 0xFFFF: each for each in context.get_ciphers()}
    for suite in hello.suites - {b"\x00\xff"}:  # the indication of renegotiation
        found = known[int.from_bytes(suite)]
        assert found["aead"], found
        assert found["strength_bits"] >= 128, found
    assert b"\x00\xff" in hello.suites or 0xFF01 in hello.extensions
