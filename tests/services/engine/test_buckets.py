"""Buckets on a simulated server of NATS."""

import asyncio

import pytest

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.engine.connection import EngineGone
from tests.simulation.engine import Engine, EngineClient, with_engine


@with_engine
async def test_a_watch_that_could_not_begin_is_told_nothing_more(
    engine: Engine, client: EngineClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = engine.begin_consumer
    monkeypatch.setattr(engine, "begin_consumer", lambda reply, *who: begin(lambda _: None, *who))
    engine.write("settings", b"1")
    told: list[Change | None] = []
    with pytest.raises(EngineGone, match="no answer"):
        await engine.bucket(client).watch(told.append)
    assert told
    told.clear()
    engine.write("settings", b"2")
    await asyncio.sleep(1.0)
    assert told == []


@with_engine
async def test_contents_from_a_server_that_lags_behind_are_complete_with_their_last_key(
    engine: Engine, client: EngineClient
) -> None:
    engine.write("a", b"1")
    engine.write("b", b"2")
    told: list[Change | None] = []
    engine.served = 0  # of a server that was just started
    await engine.bucket(client).watch(told.append)
    await asyncio.sleep(1.0)
    assert told == []
    engine.catch_up(to=1)
    await asyncio.sleep(1.0)
    assert [each and each.key for each in told] == ["a"]
    engine.catch_up()
    engine.write("c", b"3")
    await asyncio.sleep(1.0)
    assert [each and each.key for each in told] == ["a", "b", None, "c"]


@with_engine
async def test_an_empty_bucket_is_complete_at_once(engine: Engine, client: EngineClient) -> None:
    told: list[Change | None] = []
    await engine.bucket(client).watch(told.append)
    assert told == [None]


@with_engine
async def test_a_write_that_was_answered_too_late_is_not_done_again(
    engine: Engine, client: EngineClient
) -> None:
    bucket = engine.bucket(client)
    revision = await bucket.put("a", b"1", 0)
    for last in (0, revision + 7):  # no such key, or another revision
        assert await bucket.put("a", b"9", last) == 0
    engine.delay, usual = (1.5, 1.5), engine.delay
    with pytest.raises(EngineGone, match="no answer"):
        await bucket.put("a", b"2", revision)
    engine.delay = usual
    await asyncio.sleep(5)
    for value in (b"2", None):
        assert await bucket.put("a", value, revision) == 0
    assert engine.latest is not None
    assert engine.latest["a"].value == b"2"
