"""
tmodbus over TLS, both ways: its client on our server, our clients on its server.

It needs Python 3.12, where the test extra installs it; elsewhere nothing here runs.
"""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, IllegalFunction, ModbusConnectionError
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.interop import (
    TIMEOUT,
    UNIT,
    case_id,
    cells,
    coil,
    holding_register,
    make_device,
    our_tls_server,
)
from tests.support.tls import VERSIONS, context

tmodbus = pytest.importorskip("tmodbus", reason="tmodbus needs Python 3.12")

VERSION = pytest.mark.parametrize("version", VERSIONS.values(), ids=VERSIONS)


# Function -> the call, and its result; None without a result.
ASKED: dict[int, tuple[Any, Any]] = {
    1: (lambda c: c.read_coils(12, 3), cells(coil, 12, 3)),
    2: (lambda c: c.read_discrete_inputs(20, 9), [number % 5 < 2 for number in range(20, 29)]),
    3: (lambda c: c.read_holding_registers(100, 125), cells(holding_register, 100, 125)),
    4: (lambda c: c.read_input_registers(200, 2), [65335, 65334]),
    5: (lambda c: c.write_single_coil(10, True), True),
    6: (lambda c: c.write_single_register(101, 65535), 65535),
    7: (lambda c: c.read_exception_status(), 0x6D),
    15: (lambda c: c.write_multiple_coils(13, [True, False, True]), 3),
    16: (lambda c: c.write_multiple_registers(101, list(range(123))), 123),
    22: (lambda c: c.mask_write_register(250, 0x00F0, 0xA50F), (0x00F0, 0xA50F)),
    23: (lambda c: c.read_write_multiple_registers(100, 2, 101, [7]), [1100, 7]),
    24: (lambda c: c.read_fifo_queue(100), [440, 4740]),
}


def ask(pki: Pki, port: int, request: Any, version: ssl.TLSVersion) -> Any:
    async def run() -> Any:
        client = tmodbus.create_async_tcp_client(
            "127.0.0.1",
            port,
            unit_id=UNIT,
            timeout=TIMEOUT,
            auto_reconnect=False,
            ssl=context(pki, certificates.client(), version),
        )
        async with client:
            return await request(client)

    return asyncio.run(run())


@VERSION
@pytest.mark.parametrize(
    "function", [pytest.param(item, id=case_id("tmodbus", "server", "tls", item)) for item in ASKED]
)
def test_a_tmodbus_client_and_our_server_agree(pki: Pki, function: int, version: ssl.TLSVersion):
    request, result = ASKED[function]
    with our_tls_server(pki, {UNIT: make_device()}) as wire:
        assert ask(pki, wire.port, request, version) == result


@contextlib.contextmanager
def its_server(pki: Pki, roles: list[str | None]) -> Iterator[int]:
    """A tmodbus server that answers an operator's reads with their addresses, and no others."""
    from tmodbus.exceptions import IllegalFunctionError
    from tmodbus.pdu import ReadHoldingRegistersPDU, WriteMultipleRegistersPDU
    from tmodbus.server import AsyncTcpServer, ModbusRequestRouter
    from tmodbus.server.security import extract_modbus_role

    router = ModbusRequestRouter()

    def check(request: Any, context: Any) -> None:
        roles.append(extract_modbus_role(context.client_cert))
        if roles[-1] != "Operator":
            raise IllegalFunctionError(request.function_code)

    @router.register(ReadHoldingRegistersPDU)
    async def read(unit: int, request: Any, context: Any) -> list[int]:
        check(request, context)
        return [request.start_address + number for number in range(request.quantity)]

    @router.register(WriteMultipleRegistersPDU)
    async def write(unit: int, request: Any, context: Any) -> int:
        check(request, context)
        return len(request.values)

    files = pki.files(certificates.server())
    tls = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=str(pki.ca))
    tls.load_cert_chain(files.cert, files.key)
    tls.verify_mode = ssl.CERT_REQUIRED
    started: Future[tuple[int, Any]] = Future()

    async def serve() -> None:
        stopped = asyncio.Event()
        server = AsyncTcpServer("127.0.0.1", router, port=0, ssl_context=tls)
        await server.start()
        loop = asyncio.get_running_loop()
        port = server._server.sockets[0].getsockname()[1]
        started.set_result((port, lambda: loop.call_soon_threadsafe(stopped.set)))
        await stopped.wait()
        await server.stop()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    port, stop = started.result(TIMEOUT)
    try:
        yield port
    finally:
        stop()
        thread.join()


def test_our_context_and_a_tmodbus_server_agree(pki: Pki) -> None:
    roles: list[str | None] = []
    with its_server(pki, roles) as port:
        url = f"tls://127.0.0.1:{port}?unit={UNIT}&timeout={TIMEOUT}"
        for _ in range(2):
            with Client(url, security=pki.client()) as plc:
                assert plc.read_holding_registers(100, 125) == list(range(100, 225))
                plc.write_registers(7, [1, 2, 3])
        guest = pki.client("Guest")
        with Client(url, security=guest) as plc, pytest.raises(IllegalFunction):
            plc.read_holding_registers(100, 1)
        stranger = pki.security(certificates.client(issuer=certificates.foreign_authority()))
        with Client(url, security=stranger) as plc, pytest.raises(ModbusConnectionError):
            plc.read_holding_registers(100, 1)
    assert roles == ["Operator"] * 4 + ["Guest"]


def test_our_asyncio_client_and_a_tmodbus_server_agree(pki: Pki) -> None:
    roles: list[str | None] = []

    async def read(port: int) -> list[list[int]]:
        url = f"tls://127.0.0.1:{port}?unit={UNIT}&timeout={TIMEOUT}"
        async with AsyncClient(url, security=pki.client()) as plc:
            reads = (plc.read_holding_registers(first, 2) for first in range(40))
            return await asyncio.gather(*reads)

    with its_server(pki, roles) as port:
        assert asyncio.run(read(port)) == [[first, first + 1] for first in range(40)]
    assert roles == ["Operator"] * 40
