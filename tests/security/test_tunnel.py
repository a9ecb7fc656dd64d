"""
The end of a TLS connection that has no socket, against Python's own; where its records end.
"""

from __future__ import annotations

import random
import ssl

import pytest

from libmodbus_py.security.tunnel import Records, Tunnel
from tests.support import certificates
from tests.support.certificates import Papers
from tests.support.tls import VERSIONS, context


class Peer:
    """Python's client, at the other end of a tunnel."""

    def __init__(self, told: ssl.SSLContext, tunnel: Tunnel) -> None:
        self._incoming, self._outgoing = ssl.MemoryBIO(), ssl.MemoryBIO()
        self.tls = told.wrap_bio(self._incoming, self._outgoing, server_hostname="localhost")
        self.tunnel = tunnel

    def exchange(self) -> None:
        self.tunnel.feed(self._outgoing.read())
        self._incoming.write(self.tunnel.outgoing())

    def shake_hands(self) -> None:
        is_done = mine = False
        for _ in range(5):
            try:
                self.tls.do_handshake()
                mine = True
            except ssl.SSLWantReadError:
                pass
            self.tunnel.feed(self._outgoing.read())
            is_done = is_done or self.tunnel.handshake()
            self._incoming.write(self.tunnel.outgoing())
        assert is_done
        assert mine


@pytest.fixture(params=VERSIONS.values(), ids=VERSIONS)
def peer(request: pytest.FixtureRequest, papers: Papers) -> Peer:
    security = papers.server()
    security.check_server()
    peer = Peer(context(papers, certificates.client(), request.param), security.to_client())
    peer.shake_hands()
    return peer


def test_bytes_pass_both_ways(peer: Peer) -> None:
    tunnel = peer.tunnel
    assert tunnel.receive() is None
    peer.tls.write(b"question")
    peer.exchange()
    assert tunnel.has_more
    assert tunnel.receive() == b"question"
    assert not tunnel.has_more
    tunnel.send(b"answer")
    peer.exchange()
    assert peer.tls.read() == b"answer"


def test_what_is_not_taken_waits(peer: Peer) -> None:
    peer.tls.write(b"0123456789")
    peer.exchange()
    assert peer.tunnel.receive(4) == b"0123"
    assert peer.tunnel.has_more
    assert peer.tunnel.receive(4) == b"4567"
    assert peer.tunnel.receive(4) == b"89"
    assert not peer.tunnel.has_more


def test_it_knows_the_other_side(peer: Peer) -> None:
    assert peer.tunnel.certificate == certificates.client().der
    assert not peer.tunnel.is_resumed
    expires = peer.tunnel.expires
    assert expires is not None
    end = certificates.end(certificates.client().certificate)
    assert ssl.cert_time_to_seconds(expires) == int(end.timestamp())


def test_a_goodbye_is_an_end_both_ways(peer: Peer) -> None:
    peer.tunnel.end()
    peer.tunnel.end()
    peer.exchange()
    assert peer.tls.read() == b""


def test_a_goodbye_of_the_other_side_is_an_empty_read(peer: Peer) -> None:
    with pytest.raises(ssl.SSLWantReadError):
        peer.tls.unwrap()
    peer.exchange()
    assert peer.tunnel.receive() == b""
    peer.tunnel.send(b"a last answer")  # to one who may still listen
    assert peer.tunnel.outgoing()


def test_what_is_no_record_is_an_error_with_an_alert(peer: Peer) -> None:
    peer.tunnel.feed(bytes(100))
    with pytest.raises(ssl.SSLError):
        peer.tunnel.receive()
    peer.tunnel.end()  # nothing more to say, and no error


# --- records (RFC 8446, 5.1) ---------------------------------------------------------------------


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
def test_one_whole_record_is_told(size: int) -> None:
    records = Records()
    assert records.follow(record(size))
    assert not records.is_midway
    assert records.follow(record(size))


@pytest.mark.parametrize(
    "data",
    [b"", record(3)[:4], record(3)[:5], record(3)[:-1], record(3) + b"\x17", record(3) + record(4)],
    ids=["nothing", "half a header", "a header", "a byte less", "a byte more", "two records"],
)
def test_anything_else_is_not_taken_for_one_record(data: bytes) -> None:
    records = Records()
    assert not records.follow(data)
    assert records.is_midway == is_midway(data)


def test_what_looks_like_a_record_within_another_one_is_none() -> None:
    records = Records()
    records.follow(record(40)[:10])
    assert not records.follow(record(3))
    assert records.is_midway


@pytest.mark.parametrize("seed", range(20))
def test_it_is_known_after_each_piece(seed: int) -> None:
    chance = random.Random(seed)
    sizes = [chance.choice([0, 1, 2, 5, 9, 260, 700]) for _ in range(60)]
    stream = b"".join(map(record, sizes))
    records, at = Records(), 0
    while at < len(stream):
        size = chance.choice([1, 2, 3, 4, 5, 6, 7, 14, 300, 1000])
        records.follow(stream[at : at + size])
        at += size
        assert records.is_midway == is_midway(stream[:at]), at
