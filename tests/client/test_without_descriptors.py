"""
Clients of a process that has no descriptor left: a connection error, and no import on the way.
"""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support.clients import ALL
from tests.support.peers import answer, peer_at

# Each is a program of its own.
pytestmark = pytest.mark.slow

# Every import opens a file, so a module that is first needed now cannot be had.
PROGRAM = """
import asyncio, errno, resource, sys
from libmodbus_py import ModbusConnectionError, ModbusError

url, kind = sys.argv[1:]
if kind == "asyncio":
    from libmodbus_py import AsyncClient
else:
    from libmodbus_py import Context
soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)

def fail(*_):
    raise ZeroDivisionError

HOOKS = [{}, {"on_state": fail}, {"trace": fail}]

def outcome(plc):
    try:
        return plc.read_holding_registers(5, 1)
    except ModbusError as error:
        return error

def told(found):
    for error in found:
        assert isinstance(error, ModbusConnectionError), repr(error)
        assert error.errno == errno.EMFILE, repr(error)
        str(error)

def blocking(options):
    plc = Context.from_url(url, native=kind == "native", max_pause=0.001, **options)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    told([outcome(plc) for _ in range(3)])
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert outcome(plc) == [5]
    plc.close()

async def asynchronous(options):
    plc = AsyncClient(url, max_pause=0.001, **options)
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, hard))
    reads = [plc.read_holding_registers(5, 1) for _ in range(3)]
    told(await asyncio.gather(*reads, return_exceptions=True))
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
    assert await plc.read_holding_registers(5, 1) == [5]
    await plc.close()

for options in HOOKS:
    asyncio.run(asynchronous(options)) if kind == "asyncio" else blocking(options)
print("ok")
"""


@ALL
@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu"])
def test_it_is_a_connection_error_that_passes(scheme: str, kind: str) -> None:
    with peer_at(scheme, lambda request, write: write(answer(request, scheme))) as peer:
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, peer.url, kind],
            capture_output=True,
            text=True,
            timeout=30,
        )
    assert done.stdout == "ok\n", done.stderr
