"""
The end of a client: for good, from anywhere, whoever waits.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError, pdu
from tests.support.clients import EVERYWHERE, Connect, World
from tests.support.peers import Write, dead, echo, ignore, peer_at, refusing, until, url_of

REQUEST = pdu.ReadHoldingRegisters(5, 1)


def good(request: bytes, write: Write) -> None:
    write(echo(request))


@EVERYWHERE
def test_close_is_idempotent_and_final(world: World) -> None:
    plc = world.connect(world.peer("tcp", good).url)
    assert not plc.closed
    plc.execute(REQUEST)
    plc.close()
    plc.close()
    assert plc.closed
    for ask in (plc.connect, lambda: plc.execute(REQUEST)):
        with pytest.raises(ModbusConnectionError, match="closed"):
            ask()
    found = plc.execute_many([REQUEST] * 3, return_exceptions=True)
    assert [type(each) for each in found] == [ModbusConnectionError] * 3


@pytest.fixture(params=["an answer", "a connection", "a pause"])
def somebody_waits(request: pytest.FixtureRequest, connect: Connect) -> Iterator[Any]:
    """A client, and what asks it and waits for longer than a test may take."""
    with contextlib.ExitStack() as stack:
        if request.param == "a connection":
            plc = connect(f"tcp://127.0.0.1:{stack.enter_context(dead())}", timeout=600)
        elif request.param == "an answer":
            plc = connect(stack.enter_context(peer_at("tcp", ignore)).url, timeout=600)
        else:
            port = stack.enter_context(refusing())
            plc = connect(url_of(port), timeout=6000, max_pause=1000)
            while plc.statistics.failed_connects < 14:  # the next pause is 800 s
                plc._driver._life.connecting()
                plc._driver._connection.failed(ModbusConnectionError("refused"), time.monotonic())
        yield plc
        plc.close()


def test_close_ends_what_others_wait_for(somebody_waits: Any) -> None:
    plc = somebody_waits
    with ThreadPoolExecutor(2) as pool:
        waiting = [pool.submit(plc.execute, REQUEST), pool.submit(plc.execute_many, [REQUEST] * 50)]
        until(lambda: plc._driver._connection.is_wanted or plc.statistics.requests)
        plc.close()
        for each in waiting:
            with pytest.raises(ModbusConnectionError):
                each.result()
