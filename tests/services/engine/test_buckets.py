"""Buckets on a simulated server of NATS."""

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py.services.engine.buckets import Change, Watch
from libmodbus_py.services.engine.connection import EngineGone
from tests.simulation.engine import Engine, EngineClient, with_engine
from tests.support.cases import each_case


@with_engine
async def test_a_watch_that_fails_at_its_beginning_gets_no_events(
    engine: Engine, client: EngineClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin = engine.begin_consumer
    monkeypatch.setattr(engine, "begin_consumer", lambda reply, *who: begin(lambda _: None, *who))
    engine.write("settings", b"1")
    changes: list[Change | None] = []
    with pytest.raises(EngineGone, match="no answer"):
        await engine.bucket(client).watch(changes.append)
    assert changes
    changes.clear()
    engine.write("settings", b"2")
    await asyncio.sleep(1.0)
    assert changes == []


@with_engine
async def test_the_contents_of_a_slow_server_are_complete_with_their_last_key(
    engine: Engine, client: EngineClient
) -> None:
    engine.write("a", b"1")
    engine.write("b", b"2")
    changes: list[Change | None] = []
    engine.served = 0  # of a server that was just started
    await engine.bucket(client).watch(changes.append)
    await asyncio.sleep(1.0)
    assert changes == []
    engine.catch_up(to=1)
    await asyncio.sleep(1.0)
    assert [change and change.key for change in changes] == ["a"]
    engine.catch_up()
    engine.write("c", b"3")
    await asyncio.sleep(1.0)
    assert [change and change.key for change in changes] == ["a", "b", None, "c"]


@with_engine
async def test_an_empty_bucket_is_complete_at_once(engine: Engine, client: EngineClient) -> None:
    changes: list[Change | None] = []
    await engine.bucket(client).watch(changes.append)
    assert changes == [None]


@with_engine
async def test_a_write_whose_answer_came_too_late_is_not_repeated(
    engine: Engine, client: EngineClient
) -> None:
    bucket = engine.bucket(client)
    revision = await bucket.put("a", b"1", 0)
    for last in (0, revision + 7):  # a missing key, or another revision
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


def message(number: int, revision: int, key: str = "a", value: bytes = b"1") -> Any:
    """Return a change of a key as the server delivers it, with the number of its delivery."""
    metadata = SimpleNamespace(sequence=SimpleNamespace(consumer=number, stream=revision))
    headers = {} if value else {"KV-Operation": "DEL"}
    return SimpleNamespace(subject=f"$KV.b.{key}", data=value, headers=headers, metadata=metadata)


class Delivering:
    """A server with some keys, which delivers some changes before it names the keys."""

    def __init__(self, keys: str, messages: list[Any]) -> None:
        self._keys = keys
        self._messages = messages

    async def subscribe(self, *_: Any, cb: Any, **__: Any) -> None:
        for message in self._messages:
            await cb(message)

    async def stream_info(self, *_: Any) -> Any:
        subjects = {f"$KV.b.{key}": 1 for key in self._keys}
        return SimpleNamespace(state=SimpleNamespace(subjects=subjects or None))


def watched(
    keys: str, messages: list[Any], early: int = 0
) -> tuple[Watch, list[Change | None], list[None]]:
    """Return a watch of keys after messages, some of which come early, the changes, and gaps."""
    changes: list[Change | None] = []
    missed: list[None] = []
    watch = Watch("b", changes.append, lambda: missed.append(None))

    async def main() -> None:
        server: Any = Delivering(keys, messages[:early])
        await watch.begin(server)
        for message in messages[early:]:
            await watch._receive(message)

    asyncio.run(main())
    return watch, changes, missed


@each_case(
    ("messages", "contents", "gaps"),
    [
        ([message(1, 5), message(2, 6, value=b"")], [(b"1", 5), None, (None, 6)], 0),
        ([message(1, 5), message(1, 5), message(2, 6)], [(b"1", 5), None], 1),  # twice
        ([message(1, 5), message(3, 7), message(2, 6)], [(b"1", 5), None], 1),  # late
        ([message(2, 5)], [], 1),  # the first message was lost
        ([message(1, 5), message(2, 4), message(2, 4)], [(b"1", 5), None, (b"1", 4)], 1),
    ],
)
def test_a_repeated_or_late_change_ends_the_watch(
    messages: list[Any], contents: list[Any], gaps: int
) -> None:
    watch, changes, missed = watched("a", messages)
    assert [change and (change.value, change.revision) for change in changes] == contents
    assert (len(missed), watch.is_broken) == (gaps, bool(gaps))
