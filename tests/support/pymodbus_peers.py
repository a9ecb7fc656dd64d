"""Clients and servers of pymodbus, on each transport that it has."""

import asyncio
import contextlib
import ssl
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from pymodbus.client import ModbusSerialClient, ModbusTcpClient, ModbusTlsClient, ModbusUdpClient
from pymodbus.framer import FramerType
from pymodbus.server import ModbusSerialServer, ModbusTcpServer, ModbusTlsServer, ModbusUdpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from libmodbus_py.ports.endpoint import parse
from libmodbus_py.tools.testing.wires import SerialWire
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.interop import (
    BAUDRATE,
    COILS,
    DISCRETE_INPUTS,
    HOLDING_REGISTERS,
    INPUT_REGISTERS,
    TIMEOUT,
    UNIT,
    coil,
    discrete_input,
    holding_register,
    input_register,
)

FRAMERS = {
    "tcp": FramerType.SOCKET,
    "rtu": FramerType.RTU,
    "ascii": FramerType.ASCII,
    "rtu+tcp": FramerType.RTU,
    "ascii+tcp": FramerType.ASCII,
    "udp": FramerType.SOCKET,
    "tls": FramerType.TLS,
}
# A pseudo-terminal has neither parity nor 7 bits, and pyserial insists on what it set.
SERIAL_SETTINGS: dict[str, Any] = {"baudrate": BAUDRATE, "parity": "N", "bytesize": 8}


def tls_context(url: str, purpose: ssl.Purpose = ssl.Purpose.SERVER_AUTH) -> ssl.SSLContext:
    """Return the context of a client, or of a server, whose certificate stands in the URL."""
    files = parse(url).options
    tls = ssl.create_default_context(purpose, cafile=files["ca"])
    tls.check_hostname = False  # the blocking client of pymodbus does not pass the host to ssl
    tls.verify_mode = ssl.CERT_REQUIRED
    tls.load_cert_chain(files["cert"], files["key"])
    return tls


@contextlib.contextmanager
def pymodbus_client(url: str, timeout: float = TIMEOUT) -> Iterator[Any]:
    end = parse(url)
    options: dict[str, Any] = {"framer": FRAMERS[end.scheme], "timeout": timeout, "retries": 0}
    client: Any
    if end.is_serial:
        client = ModbusSerialClient(end.path, **SERIAL_SETTINGS, **options)
    elif end.is_secure:
        client = ModbusTlsClient(end.host, port=end.port, sslctx=tls_context(url), **options)
    else:
        kind = ModbusUdpClient if end.is_datagram else ModbusTcpClient
        client = kind(end.host, port=end.port, **options)
    assert client.connect()
    try:
        yield client
    finally:
        client.close()


def simulated_device() -> SimDevice:
    """The tables of make_device; pymodbus has no files."""
    tables = (
        (COILS, coil, DataType.BITS),
        (DISCRETE_INPUTS, discrete_input, DataType.BITS),
        (HOLDING_REGISTERS, holding_register, DataType.REGISTERS),
        (INPUT_REGISTERS, input_register, DataType.REGISTERS),
    )
    coils, inputs, holdings, readings = (
        [SimData(addresses.start, values=[value(address) for address in addresses], datatype=kind)]
        for addresses, value, kind in tables
    )
    return SimDevice(UNIT, simdata=(coils, inputs, holdings, readings))


@contextlib.contextmanager
def in_background(make_server: Callable[[SimDevice], Any]) -> Iterator[Any]:
    """Run a server of `simulated_device` in a thread with a loop of its own."""
    started: Future[tuple[Any, Callable[[], object]]] = Future()

    async def serve() -> None:
        stop = asyncio.Event()
        loop = asyncio.get_running_loop()
        server = make_server(simulated_device())
        await server.serve_forever(background=True)
        started.set_result((server, lambda: loop.call_soon_threadsafe(stop.set)))
        await stop.wait()
        await asyncio.sleep(0.02)  # pymodbus forgets connections that begin or end at this time
        await server.shutdown()
        await asyncio.sleep(0.02)

    def run() -> None:
        try:
            asyncio.run(serve())
        except BaseException as error:
            if started.done():
                raise
            started.set_exception(error)

    thread = threading.Thread(target=run, name="pymodbus server")
    thread.start()
    try:
        server, stop = started.result()
        try:
            yield server
        finally:
            stop()
    finally:
        thread.join()


SERVERS: dict[str, Any] = {
    "tcp": ModbusTcpServer,
    "rtu": ModbusSerialServer,
    "ascii": ModbusSerialServer,
    "rtu+tcp": ModbusTcpServer,
    "ascii+tcp": ModbusTcpServer,
    "udp": ModbusUdpServer,
    "tls": ModbusTlsServer,
}


@contextlib.contextmanager
def pymodbus_serving(transport: str, **options: Any) -> Iterator[str]:
    """Serve `simulated_device`, and yield the URL of a client; options are those of the server."""
    make = partial(SERVERS[transport], framer=FRAMERS[transport], **options)
    with contextlib.ExitStack() as stack:
        if transport in ("rtu", "ascii"):
            wire = stack.enter_context(SerialWire())
            stack.enter_context(in_background(partial(make, port=wire.server, **SERIAL_SETTINGS)))
            yield f"{transport}://{wire.client}?baudrate={BAUDRATE}"
            return
        query = ""
        if transport == "tls":
            pki = Pki(Path(stack.enter_context(TemporaryDirectory())))
            own = pki.url("tls://127.0.0.1", certificates.server())
            make = partial(make, sslctx=tls_context(own, ssl.Purpose.CLIENT_AUTH))
            query = pki.url("", certificates.client())
        server = stack.enter_context(in_background(partial(make, address=("127.0.0.1", 0))))
        yield f"{transport}://127.0.0.1:{port_of(server)}{query}"


def port_of(server: Any) -> int:
    """Return the port on which a server listens."""
    listening = getattr(server.transport, "sockets", None)
    ends = listening or [server.transport.get_extra_info("socket")]
    port: int = ends[0].getsockname()[1]
    return port
