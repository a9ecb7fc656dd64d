"""
The key exchange of TLS 1.3: that of the linked OpenSSL's default, which from 3.5 on is a hybrid of
X25519 and ML-KEM-768, so that what is recorded today stays secret from quantum computers.
"""

import ssl

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.tools.testing.wires import TcpWire
from tests.support.certificates import Papers
from tests.support.clients import ALL, asking

HANDSHAKE, SERVER_HELLO, KEY_SHARE = 22, 2, 51

# IANA's registry of TLS Supported Groups.
X25519, X25519MLKEM768 = 29, 4588


def named_group(sent: bytes) -> int:
    """Return the group that a server chose, from its first record (RFC 8446, 4.1.3 and 4.2.8)."""
    assert (sent[0], sent[5]) == (HANDSHAKE, SERVER_HELLO)
    at = 5 + 4 + 2 + 32  # record, handshake, version, random
    at += 1 + sent[at]  # session
    at += 2 + 1  # cipher suite, compression
    end = at + 2 + int.from_bytes(sent[at : at + 2])
    at += 2
    while at < end:
        kind, size = (int.from_bytes(sent[at + skip : at + skip + 2]) for skip in (0, 2))
        if kind == KEY_SHARE:
            return int.from_bytes(sent[at + 4 : at + 6])
        at += 4 + size
    raise AssertionError("a ServerHello without a key share")


@ALL
def test_both_ends_agree_on_the_best_group_of_their_openssl(kind: str, papers: Papers) -> None:
    server = Server(Device(Mapping(holding_registers={0: [7]})), security=papers.server())
    with (
        server.background("tls://127.0.0.1:0") as running,
        TcpWire(parse(running.urls[0]).port) as wire,
    ):
        url = f"tls://127.0.0.1:{wire.port}"
        with asking(kind, url, security=papers.client()) as client:
            assert client.read_holding_registers(0, 1) == [7]
        sent = wire.sent_by("server")
    has_hybrid = ssl.OPENSSL_VERSION_INFO >= (3, 5)
    assert named_group(sent) == (X25519MLKEM768 if has_hybrid else X25519)
