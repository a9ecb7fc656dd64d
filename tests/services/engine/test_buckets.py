"""
Buckets on a simulated server of NATS.
"""

from __future__ import annotations

import asyncio

import pytest

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.engine.errors import EngineGone
from tests.simulation.engine import Engine
from tests.simulation.network import Network


def test_a_watch_that_could_not_begin_is_told_nothing_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    network = Network()
    engine = Engine(network)
    monkeypatch.setattr(engine, "consumer_info", lambda reply, subscription: None)
    engine.write("settings", b"1")
    told: list[Change | None] = []

    async def main() -> None:
        client = engine.client()
        with pytest.raises(EngineGone, match="no answer"):
            await engine.bucket(client).watch(told.append)
        assert told
        told.clear()
        engine.write("settings", b"2")
        await asyncio.sleep(1.0)
        assert told == []
        await client.close()

    network.run(main)
