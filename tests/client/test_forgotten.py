"""
What clients leave behind that nobody closed.
"""

from __future__ import annotations

import asyncio
import gc
import subprocess
import sys
import warnings
from typing import Any

import pytest

from libmodbus_py import AsyncClient, RtuContext
from tests.support.collecting import new_garbage_only
from tests.support.peers import FakeServer, FakeUnit, answer, until
from tests.support.scripted import run as run_watched


def rtu(request: bytes) -> bytes:
    return answer(request, "rtu")


def forgotten(main: Any) -> None:
    asyncio.run(main)
    gc.collect()


def test_a_forgotten_client_says_so_and_frees_its_port() -> None:
    with FakeUnit(lambda request: [rtu(request)]) as unit:

        async def forget() -> None:
            client = AsyncClient(f"rtu://{unit.path}?baudrate=115200")
            assert await client.read_holding_registers(3, 1) == [3]

        for times in range(2):
            with pytest.warns(ResourceWarning, match=unit.path):
                forgotten(forget())
            with RtuContext(unit.path, 115200) as context:
                assert context.read_holding_registers(times, 1) == [times]


@pytest.mark.filterwarnings("error::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_forgotten_client_frees_its_port_where_warnings_are_errors() -> None:
    with FakeUnit(lambda request: [rtu(request)]) as unit:

        async def forget() -> None:
            client = AsyncClient(f"rtu://{unit.path}?baudrate=115200")
            assert await client.read_holding_registers(3, 1) == [3]

        asyncio.run(forget())
        gc.collect()
        with RtuContext(unit.path, 115200) as context:
            assert context.read_holding_registers(1, 1) == [1]


def test_a_client_forgotten_while_it_connects_leaves_nothing() -> None:
    async def main() -> None:
        for steps in range(6):
            client = AsyncClient(server.url)
            asked = asyncio.create_task(client.connect())
            for _ in range(steps):
                await asyncio.sleep(0)
            asked.cancel()
            await asyncio.wait([asked])
            del client, asked
            gc.collect()
        async with AsyncClient(server.url) as last:  # those before it are accepted
            assert await last.read_holding_registers(1, 1) == [1]
        until(lambda: not server._peers)

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        with FakeServer(lambda request: [answer(request, "tcp")]) as server, new_garbage_only():
            run_watched(main())


def test_a_port_is_opened_that_a_killed_program_left_as_it_was() -> None:
    """Its settings are those that are to be set, and a pseudo-terminal refuses one of them."""
    with FakeUnit(lambda request: [rtu(request)]) as unit:
        program = (
            "import os, sys, libmodbus_py as m\n"
            "context = m.RtuContext(sys.argv[1], 115200)\n"
            "context.connect()\n"
            "os.kill(os.getpid(), 9)"
        )
        for times in range(3):
            subprocess.run([sys.executable, "-c", program, unit.path], check=False, timeout=30)
            if times:
                with RtuContext(unit.path, 115200) as context:
                    assert context.read_holding_registers(times, 1) == [times]
