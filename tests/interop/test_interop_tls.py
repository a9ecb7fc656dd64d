"""
Clients of ours with TLS servers of others: openssl s_server, and pymodbus.
"""

import re
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError
from tests.support import certificates
from tests.support.certificates import Papers
from tests.support.clients import Connect
from tests.support.peers import mbap
from tests.support.pymodbus_peers import pymodbus_serving

LONG = 20.0


# --- openssl s_server -----------------------------------------------------------------------


class SServer:
    """
    A server that is told what to send on its standard input, and prints what it receives.

    Args:
        options: of s_server.
    """

    def __init__(self, papers: Papers, identity: Any, *options: str) -> None:
        files = papers.files(identity)
        command = ["stdbuf", "-o0", "openssl", "s_server", "-accept", "127.0.0.1:0"]
        command += ["-cert", str(files.cert), "-key", str(files.key), "-CAfile", str(papers.ca)]
        command += ["-Verify", "3", "-verify_return_error", *options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self._seen = b""
        self.port = int(self.wait_for(rb"ACCEPT 127\.0\.0\.1:(\d+)\n")[1])

    def wait_for(self, pattern: bytes) -> re.Match[bytes]:
        """Return the text that was printed up to here."""
        assert self._process.stdout is not None
        while (found := re.search(pattern, self._seen, re.DOTALL)) is None:
            data = self._process.stdout.read1(65536)  # type: ignore[attr-defined]
            assert data, self._seen
            self._seen += data
        self._seen = self._seen[found.end() :]
        return found

    def write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(data)
        self._process.stdin.flush()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def s_server(papers: Papers, identity: Any, *options: str) -> Iterator[SServer]:
    server = SServer(papers, identity, *options)
    try:
        yield server
    finally:
        server.close()


ASKED = rb"..\0\0\0\x06\x01\x03...."


def answering(server: SServer, commands: list[bytes]) -> None:
    """Answer a read for each list of commands, which are carried out first."""
    for letters in commands:
        request = server.wait_for(ASKED)[0]
        for letter in letters:
            server.write(bytes([letter]) + b"\n")
            server.wait_for(rb"SSL_do_handshake -> 1\n")
        server.write(mbap(request, b"\x03\x02" + request[8:10]))


@pytest.mark.parametrize("key", ["EC", "RSA"])
@pytest.mark.parametrize("version", ["tls1_2", "tls1_3"])
def test_s_server(connect: Connect, papers: Papers, version: str, key: str) -> None:
    """With changes of keys, asked for (K) and announced (k), where there are such."""
    options = {"key": certificates.rsa_key()} if key == "RSA" else {}
    commands = [b"", b"k", b"K", b"kkKK", b""] if version == "tls1_3" else [b""] * 5
    own = papers.security(certificates.client(**options))
    with (
        s_server(papers, certificates.server(**options), f"-{version}") as server,
        ThreadPoolExecutor() as pool,
        connect(f"tls://127.0.0.1:{server.port}", security=own, timeout=LONG) as plc,
    ):
        done = pool.submit(answering, server, commands)
        for each in range(len(commands)):
            assert plc.read_holding_registers(each, 1) == [each]
        done.result(LONG)
        assert plc.statistics.connects == 1


@pytest.mark.parametrize("version", ["tls1_2", "tls1_3"])
def test_s_server_refuses_a_certificate_of_others(
    connect: Connect, papers: Papers, version: str
) -> None:
    own = papers.security(certificates.client(issuer=certificates.foreign_authority()))
    with (
        s_server(papers, certificates.server(), f"-{version}") as server,
        pytest.raises(ModbusConnectionError, match=r"refused our certificate .*'CN=Test client'"),
        connect(f"tls://127.0.0.1:{server.port}", security=own, timeout=LONG) as plc,
    ):
        plc.read_holding_registers(0, 1)


@pytest.mark.parametrize(
    "options", [["-tls1_2", "-cipher", "AES128-GCM-SHA256"], ["-no_tls1_3", "-no_tls1_2"]]
)
def test_s_server_with_nothing_in_common(
    connect: Connect, papers: Papers, options: list[str]
) -> None:
    """Without ephemeral keys; and without a version that R-01 allows."""
    identity = certificates.server(key=certificates.rsa_key())
    with s_server(papers, identity, *options) as server:
        plc = connect(f"tls://127.0.0.1:{server.port}", security=papers.client(), timeout=LONG)
        with pytest.raises(ModbusConnectionError, match="no TLS with 127"):
            plc.connect()
        plc.close()


# --- pymodbus -------------------------------------------------------------------------------


def test_pymodbus_refuses_a_certificate_of_others(connect: Connect, papers: Papers) -> None:
    """asyncio closes without the alert that would say so."""
    own = papers.security(certificates.client(issuer=certificates.foreign_authority()))
    with (
        pymodbus_serving("tls") as url,
        pytest.raises(ModbusConnectionError, match="it may have refused our certificate"),
        connect(url.partition("?")[0], security=own, timeout=LONG) as plc,
    ):
        plc.read_holding_registers(0, 1)
