"""
The end of a TLS connection that has no socket, against Python's own.
"""

from __future__ import annotations

import ssl
from pathlib import Path

import pytest

from libmodbus_py.security.tunnel import Tunnel
from tests.support import certificates
from tests.support.certificates import Papers
from tests.support.tls import VERSIONS, context

VERSION = pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)


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
def peer(request: pytest.FixtureRequest, tmp_path: Path) -> Peer:
    papers = Papers(tmp_path)
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
