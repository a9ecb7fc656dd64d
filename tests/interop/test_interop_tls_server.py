"""
TLS clients of others on our server: pymodbus's, and openssl's.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import subprocess
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from pymodbus.client import AsyncModbusTlsClient, ModbusTlsClient

from libmodbus_py import Access, Device, Mapping
from libmodbus_py.tools.testing.wires import TcpWire
from tests.interop.test_interop_pymodbus import COUNTING, Asked, asked, asked_in_vain
from tests.support import certificates
from tests.support.attacks import adu
from tests.support.certificates import Papers
from tests.support.interop import (
    COILS,
    TIMEOUT,
    UNIT,
    Record,
    case_id,
    cells,
    coil,
    make_device,
    our_tls_server,
    restore,
    tried,
)
from tests.support.tls import VERSIONS, context


def without_names(told: ssl.SSLContext) -> ssl.SSLContext:
    """Its blocking client does not tell ssl whom it wants."""
    told.check_hostname = False
    return told


@contextlib.contextmanager
def pymodbus_client(papers: Papers, port: int) -> Iterator[Any]:
    told = without_names(context(papers, certificates.client()))
    client = ModbusTlsClient("127.0.0.1", port=port, sslctx=told, timeout=TIMEOUT, retries=0)
    assert client.connect()
    try:
        yield client
    finally:
        client.close()


def over_tls(cases: Iterator[Asked]) -> Iterator[tuple[str, Asked]]:
    """Yield what is asked over TCP, each case with its id."""
    for case in cases:
        if "tcp" in case.transports:
            yield case_id("pymodbus", "server", "tls", case.function, case.name), case


@contextlib.contextmanager
def our_servers(papers: Papers) -> Iterator[Callable[[Asked], tuple[TcpWire, Device]]]:
    """Yield what returns a server for a case: the same one, restored, or one of its own."""
    device = make_device()
    with our_tls_server(papers, {UNIT: device}) as wire, contextlib.ExitStack() as own:

        def server(case: Asked) -> tuple[TcpWire, Device]:
            own.close()
            if case.function in COUNTING:
                counting = make_device()
                return own.enter_context(our_tls_server(papers, {UNIT: counting})), counting
            restore(device)
            return wire, device

        yield server


def test_pymodbus_client_and_our_server_agree(papers: Papers, record_property: Record) -> None:
    with our_servers(papers) as server:
        for check, case in tried(record_property, over_tls(asked())):
            with check:
                wire, device = server(case)
                with pymodbus_client(papers, wire.port) as client:
                    response = case.ask(client)
                assert not response.isError(), response
                assert case.answer(response) == case.expected
                assert case.look(device) == case.seen


def test_pymodbus_client_sees_our_refusal_and_nothing_changes(
    papers: Papers, record_property: Record
) -> None:
    untouched = make_device()
    with our_servers(papers) as server:
        for check, case in tried(record_property, over_tls(asked_in_vain())):
            with check:
                wire, device = server(case)
                with pymodbus_client(papers, wire.port) as client:
                    response = case.ask(client)
                    assert response.isError()
                    assert response.exception_code == case.expected
                    assert client.read_coils(12, device_id=UNIT).bits[0] is True
                assert device.mapping.coils[:] == untouched.mapping.coils[:]
                registers = untouched.mapping.holding_registers[:]
                assert device.mapping.holding_registers[:] == registers
                assert list(device.files[4]) == list(untouched.files[4])


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
        told = without_names(context(papers))
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
