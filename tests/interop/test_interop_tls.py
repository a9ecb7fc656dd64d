"""TLS with other programs: openssl, and clients and servers of other packages."""

import asyncio
import re
import ssl
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTlsClient, ModbusTlsClient

from libmodbus_py import Access, Device, Mapping, ModbusConnectionError
from libmodbus_py.security.certificates import ROLE_OID, role_of
from libmodbus_py.tools.certificates import make
from tests.support import certificates
from tests.support.attacks import adu
from tests.support.certificates import Pki
from tests.support.clients import Connect
from tests.support.interop import COILS, TIMEOUT, UNIT, cells, coil, make_device, our_tls_server
from tests.support.peers import mbap
from tests.support.pymodbus_peers import pymodbus_serving
from tests.support.tls import VERSIONS, context

LONG = 20.0


class SServer:
    """
    A server that is told what to send on its standard input, and prints what it receives.
    `options`: of s_server.
    """

    def __init__(self, pki: Pki, identity: Any, *options: str) -> None:
        files = pki.files(identity)
        command = ["stdbuf", "-o0", "openssl", "s_server", "-accept", "127.0.0.1:0"]
        command += ["-cert", str(files.cert), "-key", str(files.key), "-CAfile", str(pki.ca)]
        command += ["-Verify", "3", "-verify_return_error", *options]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        )
        self._seen = b""
        self.port = int(self.wait_for(rb"ACCEPT 127\.0\.0\.1:(\d+)\n")[1])

    def wait_for(self, pattern: bytes) -> re.Match[bytes]:
        """Return the text that was printed up to here."""
        assert self._process.stdout is not None
        while (match := re.search(pattern, self._seen, re.DOTALL)) is None:
            data = self._process.stdout.read1(65536)  # type: ignore[attr-defined]
            assert data, self._seen
            self._seen += data
        self._seen = self._seen[match.end() :]
        return match

    def write(self, data: bytes) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(data)
        self._process.stdin.flush()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@contextmanager
def s_server(pki: Pki, identity: Any, *options: str) -> Iterator[SServer]:
    server = SServer(pki, identity, *options)
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
def test_clients_talk_with_s_server(connect: Connect, pki: Pki, version: str, key: str) -> None:
    """With changes of keys, asked for (K) and announced (k), where there are such."""
    options = {"key": certificates.rsa_key()} if key == "RSA" else {}
    commands = [b"", b"k", b"K", b"kkKK", b""] if version == "tls1_3" else [b""] * 5
    own = pki.security(certificates.client(**options))
    with (
        s_server(pki, certificates.server(**options), f"-{version}") as server,
        ThreadPoolExecutor() as pool,
        connect(f"tls://127.0.0.1:{server.port}", security=own, timeout=LONG) as plc,
    ):
        future = pool.submit(answering, server, commands)
        for number in range(len(commands)):
            assert plc.read_holding_registers(number, 1) == [number]
        future.result(LONG)
        assert plc.statistics.connects == 1


@pytest.mark.parametrize("version", ["tls1_2", "tls1_3"])
def test_s_server_refuses_another_authority(connect: Connect, pki: Pki, version: str) -> None:
    own = pki.security(certificates.client(issuer=certificates.foreign_authority()))
    with (
        s_server(pki, certificates.server(), f"-{version}") as server,
        pytest.raises(ModbusConnectionError, match=r"refused our certificate .*'CN=Test client'"),
        connect(f"tls://127.0.0.1:{server.port}", security=own, timeout=LONG) as plc,
    ):
        plc.read_holding_registers(0, 1)


@pytest.mark.parametrize(
    "options", [["-tls1_2", "-cipher", "AES128-GCM-SHA256"], ["-no_tls1_3", "-no_tls1_2"]]
)
def test_s_server_without_common_ciphers(connect: Connect, pki: Pki, options: list[str]) -> None:
    """Without ephemeral keys; and without a version that R-01 allows."""
    identity = certificates.server(key=certificates.rsa_key())
    with s_server(pki, identity, *options) as server:
        plc = connect(f"tls://127.0.0.1:{server.port}", security=pki.client(), timeout=LONG)
        with pytest.raises(ModbusConnectionError, match="no TLS with 127"):
            plc.connect()
        plc.close()


def test_pymodbus_refuses_a_certificate_of_another_authority(connect: Connect, pki: Pki) -> None:
    """asyncio closes without the alert that would say so."""
    own = pki.security(certificates.client(issuer=certificates.foreign_authority()))
    with (
        pymodbus_serving("tls") as url,
        pytest.raises(ModbusConnectionError, match="it may have refused our certificate"),
        connect(url.partition("?")[0], security=own, timeout=LONG) as plc,
    ):
        plc.read_holding_registers(0, 1)


def openssl(*arguments: object) -> str:
    command = ["openssl", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


@pytest.mark.parametrize("role", ["Operator", "Prüfer", "x" * 200])
def test_openssl_reads_the_role_as_a_utf8string(tmp_path: Path, role: str) -> None:
    files = certificates.save(tmp_path, certificates.client(role), "client")
    parsed = openssl("asn1parse", "-in", files.cert)
    # The identifier, by number for it has no name, and behind it the octets of the extension.
    octets = re.search(rf":{re.escape(ROLE_OID)}\n.*OCTET STRING +\[HEX DUMP\]:(\w+)\n", parsed)
    assert octets
    (tmp_path / "role.der").write_bytes(bytes.fromhex(octets[1]))
    inner = openssl("asn1parse", "-inform", "DER", "-in", tmp_path / "role.der")
    assert re.fullmatch(
        rf" +0:d=0 +hl=[23] l= *{len(role.encode())} prim: UTF8STRING +:.*\n", inner
    )
    if role.isascii():
        assert inner.rstrip("\n").endswith(f":{role}")
        text = openssl("x509", "-in", files.cert, "-noout", "-text")
        assert re.search(rf"{re.escape(ROLE_OID)}: *\n.*{role}\n", text)


def test_openssl_verifies_certificates_strictly_for_both_purposes(tmp_path: Path) -> None:
    ca = certificates.save(tmp_path, certificates.authority(), "ca").cert
    below = certificates.intermediate()
    middle = certificates.save(tmp_path, below, "middle").cert
    for issuer in (certificates.authority(), below):
        identity = make("one of ours", issuer, hosts=certificates.HOSTS, role="Operator")
        cert = certificates.save(tmp_path, identity, "one").cert
        for purpose in ("sslserver", "sslclient"):
            openssl(
                *("verify", "-x509_strict", "-check_ss_sig", "-purpose", purpose),
                *("-CAfile", ca, "-untrusted", middle, "-verify_ip", "127.0.0.1", cert),
            )


def test_the_role_of_an_openssl_certificate_is_read(tmp_path: Path) -> None:
    openssl(
        *("req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes"),
        *("-keyout", tmp_path / "key.pem", "-out", tmp_path / "cert.der", "-outform", "DER"),
        *("-subj", "/CN=peer", "-addext", f"{ROLE_OID}=ASN1:UTF8String:Operator"),
    )
    assert role_of((tmp_path / "cert.der").read_bytes()) == "Operator"


def test_pymodbus_asyncio_client_has_many_requests_in_flight(pki: Pki) -> None:
    async def ask(port: int) -> list[list[bool]]:
        client = AsyncModbusTlsClient(
            "127.0.0.1", port=port, sslctx=context(pki, certificates.client()), timeout=TIMEOUT
        )
        assert await client.connect()
        reads = [client.read_coils(first, count=8, device_id=UNIT) for first in COILS[:50]]
        answers = await asyncio.gather(*reads)
        transport = client.ctx.transport
        client.close()
        transport.abort()  # otherwise it waits for our close notify after the loop has closed
        return [answer.bits[:8] for answer in answers]

    with our_tls_server(pki, {UNIT: make_device()}) as wire:
        assert asyncio.run(ask(wire.port)) == [cells(coil, first, 8) for first in COILS[:50]]


def test_pymodbus_client_without_a_certificate_gets_no_answer(pki: Pki) -> None:
    with our_tls_server(pki, {UNIT: make_device()}) as wire:
        context_ = context(pki)
        context_.check_hostname = False  # pymodbus does not pass the host to ssl
        client = ModbusTlsClient("127.0.0.1", port=wire.port, sslctx=context_, timeout=1, retries=0)
        try:
            assert client.connect()  # TLS 1.3: the refusal follows the handshake
            with pytest.raises((ssl.SSLError, OSError)):
                client.read_coils(12, device_id=UNIT)
        finally:
            client.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_openssl_s_client_carries_requests_and_a_role(pki: Pki, version: str) -> None:
    roles: list[str | None] = []

    def note(access: Access) -> None:
        roles.append(access.role)

    device = Device(Mapping(holding_registers=[range(100, 110)]), before_read=note)
    device.mapping.holding_registers[100:110] = range(1000, 1010)
    files = pki.files(certificates.client("Überwacher"))
    with our_tls_server(pki, {UNIT: device}) as wire:
        command = (
            *("openssl", "s_client", "-connect", f"127.0.0.1:{wire.port}", "-quiet"),
            *("-CAfile", pki.ca, "-verify_return_error", "-verify_hostname", "localhost"),
            *("-cert", files.cert, "-key", files.key, f"-tls{version.replace('.', '_')}"),
        )
        with subprocess.Popen(
            [*map(str, command)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        ) as process:
            assert process.stdin is not None
            assert process.stdout is not None
            process.stdin.write(adu(bytes.fromhex("03 0064 000a")))
            process.stdin.flush()
            values = b"".join(value.to_bytes(2, "big") for value in range(1000, 1010))
            response = adu(bytes([3, 20]) + values)
            assert process.stdout.read(len(response)) == response
            process.kill()
    assert roles == ["Überwacher"]
