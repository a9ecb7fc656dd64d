"""
One server in Python, in a process of its own: servers.py NAME

Holding register N holds N, for every unit. Prints its port on 127.0.0.1 when it is ready.
"""

from __future__ import annotations

import asyncio
import resource
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

REGISTERS = 65_536
HOST = "127.0.0.1"


def announce(port: int) -> None:
    print(port, flush=True)


def ours(
    meter: Callable[[Any], object] = lambda server: None, **hooks: Callable[[object], object]
) -> None:
    from libmodbus_py import Device, Mapping, Server

    mapping = Mapping(holding_registers=REGISTERS)
    # Piece by piece: what a long list leaves free would hide the memory of connections.
    for start in range(0, REGISTERS, 256):
        mapping.holding_registers[start : start + 256] = range(start, start + 256)

    # All clients are on this machine, and an address may have a tenth of what descriptors allow.
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))

    async def serve() -> None:
        server = Server(Device(mapping, **hooks))
        meter(server)
        async with server.serving(f"tcp://{HOST}:0") as running:
            announce(int(running.urls[0].rpartition(":")[2]))
            await asyncio.Event().wait()

    asyncio.run(serve())


def ours_with_read_hook() -> None:
    ours(before_read=lambda access: None)


def ours_with_write_hook() -> None:
    ours(before_write=lambda access: None)


def ours_with_metrics() -> None:
    """With Prometheus metrics that are scraped each second."""
    import prometheus_client

    from libmodbus_py.services.integrations.prometheus import collect

    def scrape() -> None:
        while True:
            prometheus_client.generate_latest()
            time.sleep(1)

    def meter(server: Any) -> None:
        collect(server)
        threading.Thread(target=scrape, daemon=True).start()

    ours(meter=meter)


def pymodbus() -> None:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    registers = SimData(0, values=list(range(REGISTERS)), datatype=DataType.REGISTERS)

    async def serve() -> None:
        server = ModbusTcpServer(SimDevice(0, simdata=registers), address=(HOST, 0))
        await server.serve_forever(background=True)
        announce(server.transport.sockets[0].getsockname()[1])
        await asyncio.Event().wait()

    asyncio.run(serve())


def pymodbustcp() -> None:
    from pyModbusTCP.server import DataBank, ModbusServer

    bank = DataBank()
    bank.set_holding_registers(0, list(range(REGISTERS)))
    server = ModbusServer(HOST, 0, no_block=True, data_bank=bank)
    server.start()
    announce(server._service.server_address[1])  # pymodbus tells its port in no other way
    server._serve_th.join()


SERVERS: dict[str, Callable[[], None]] = {
    "ours": ours,
    "ours-with-read-hook": ours_with_read_hook,
    "ours-with-write-hook": ours_with_write_hook,
    "ours-with-metrics": ours_with_metrics,
    "pymodbus": pymodbus,
    "pyModbusTCP": pymodbustcp,
}


if __name__ == "__main__":
    SERVERS[sys.argv[1]]()
