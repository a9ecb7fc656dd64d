"""
TLS clients of others on our server: pymodbus's, and openssl's.
"""

import asyncio
import ssl
import subprocess

import pytest
from pymodbus.client import AsyncModbusTlsClient, ModbusTlsClient

from libmodbus_py import Access, Device, Mapping
from tests.support import certificates
from tests.support.attacks import adu
from tests.support.certificates import Papers
from tests.support.interop import (
    COILS,
    TIMEOUT,
    UNIT,
    cells,
    coil,
    make_device,
    our_tls_server,
)
from tests.support.tls import VERSIONS, context


def test_pymodbus_asyncio_client_has_many_requests_in_flight(papers: Papers) -> None:
    async def ask(port: int) -> list[list[bool]]:
        client = AsyncModbusTlsClient(
            "127.0.0.1", port=port, sslctx=context(papers, certificates.client()), timeout=TIMEOUT
        )
        assert await client.connect()
        reads = [client.read_coils(first, count=8, device_id=UNIT) for first in COILS[:50]]
        answers = await asyncio.gather(*reads)
        transport = client.ctx.transport
        client.close()
        transport.abort()  # else it waits for our last word, and the loop may be gone before
        return [answer.bits[:8] for answer in answers]

    with our_tls_server(papers, {UNIT: make_device()}) as wire:
        assert asyncio.run(ask(wire.port)) == [cells(coil, first, 8) for first in COILS[:50]]


def test_pymodbus_client_without_a_certificate_gets_no_answer(papers: Papers) -> None:
    with our_tls_server(papers, {UNIT: make_device()}) as wire:
        told = context(papers)
        told.check_hostname = False  # its blocking client does not tell ssl whom it wants
        client = ModbusTlsClient("127.0.0.1", port=wire.port, sslctx=told, timeout=1, retries=0)
        try:
            assert client.connect()  # TLS 1.3: the refusal comes behind its handshake
            with pytest.raises((ssl.SSLError, OSError)):
                client.read_coils(12, device_id=UNIT)
        finally:
            client.close()


@pytest.mark.parametrize("version", VERSIONS)
def test_openssl_s_client_carries_requests_and_a_role(papers: Papers, version: str) -> None:
    roles: list[str | None] = []

    def note(access: Access) -> None:
        roles.append(access.role)

    device = Device(Mapping(holding_registers=[range(100, 110)]), before_read=note)
    device.mapping.holding_registers[100:110] = range(1000, 1010)
    files = papers.files(certificates.client("Überwacher"))
    with our_tls_server(papers, {UNIT: device}) as wire:
        command = (
            *("openssl", "s_client", "-connect", f"127.0.0.1:{wire.port}", "-quiet"),
            *("-CAfile", papers.ca, "-verify_return_error", "-verify_hostname", "localhost"),
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
            expected = adu(bytes([3, 20]) + values)
            assert process.stdout.read(len(expected)) == expected
            process.kill()
    assert roles == ["Überwacher"]
