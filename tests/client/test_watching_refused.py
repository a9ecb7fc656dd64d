"""
An event loop that can watch no more descriptors: the client says so, and hangs nobody up.
"""

from __future__ import annotations

import asyncio
import errno
import os
from typing import Any

import pytest

from libmodbus_py import AsyncClient, ModbusConnectionError
from tests.support.peers import FakeServer, echo


def full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_loop_that_can_watch_no_more_is_told_as_what_it_is() -> None:
    async def go() -> None:
        loop = asyncio.get_running_loop()
        plc = AsyncClient(server.url, max_pause=0)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(loop, "add_reader", full)
            with pytest.raises(ModbusConnectionError, match="cannot wait for tcp://127") as caught:
                await plc.read_holding_registers(7, 1)
            assert caught.value.errno == errno.ENOSPC
        assert await plc.read_holding_registers(7, 1) == [7]
        await plc.close()

    with FakeServer(lambda request: [echo(request)]) as server:
        asyncio.run(go())
