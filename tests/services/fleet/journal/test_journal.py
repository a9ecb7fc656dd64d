"""
A fleet with a journal, on simulated time and real files: outputs that are away, slow or gone, and
how it begins and ends.
"""

import asyncio
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Journal, JournalError
from libmodbus_py.services.fleet.journal import journal as journal_module
from libmodbus_py.services.fleet.journal import place as recent
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from tests.services.fleet.fleets import Peer, in_simulated_time, meter, until
from tests.services.fleet.journal.journals import in_journal, journal_of, query, readings, run_for
from tests.support.outputs import FakeOutput

HOUR = 3600.0


def test_a_broker_that_was_unreachable_for_an_hour_gets_all_readings(path: str, inline: None):
    broker, other = FakeOutput("north", is_away=True), FakeOutput("south")

    async def come_back(fleet: Fleet) -> None:
        # As long as the broker was away, its readings were on the disk only.
        assert fleet.statistics.outputs["north"].waiting == len(other.ids) > 1000
        broker.is_away = False
        await until(lambda: fleet.statistics.outputs["north"].waiting == 0)

    fleet = run_for(path, HOUR - 60, broker, other, change=come_back)
    assert broker.ids == other.ids == in_journal(path)
    assert [output.dropped for output in fleet.statistics.outputs.values()] == [0, 0]
    assert len({*broker.ids}) == len(broker.ids)
    journal = journal_of(fleet)
    assert (journal.dropped, journal.failures, journal.trouble) == (0, 0, "")


def test_an_output_continues_in_the_next_run(path: str, inline: None) -> None:
    away, present = FakeOutput("north", is_away=True), FakeOutput("south")
    run_for(path, 100, away, present)
    assert away.ids == []
    first = list(present.ids)
    again, new = FakeOutput("north"), FakeOutput("new")
    run_for(path, 100, again, new)
    every = in_journal(path)
    assert again.ids == every
    assert new.ids == every[len(first) :]  # it begins with the next reading
    late = FakeOutput("south")
    run_for(path, 100, late)
    assert late.ids == in_journal(path)[len(first) :]


def test_a_live_output_gets_the_readings_of_this_run_only(path: str, inline: None) -> None:
    run_for(path, 100, FakeOutput("live", is_away=True))
    live = FakeOutput("live")
    live.is_live = True
    fleet = run_for(path, 100, live)
    assert len(live.ids) == fleet.statistics.readings
    assert live.ids == in_journal(path)[-len(live.ids) :]


@in_simulated_time
async def test_readings_have_ids_for_programs_too(path: str, inline: None) -> None:
    async with Peer() as peer:
        device = meter("a", peer.url, interval=10)
        fleet = Fleet([device], journal=Journal(path))
        iterator = fleet.readings()
        async with fleet:
            await asyncio.sleep(25)
            fleet.replace([])
            await asyncio.sleep(1)
        results = [reading async for reading in iterator]
    assert results[-1].quality == "offline"
    assert [item.id for item in results] == list(range(results[0].id, results[0].id + len(results)))
    assert [result.id for result in results] == in_journal(path)


@in_simulated_time
async def test_an_output_that_is_slower_than_the_readings_is_bounded_by_the_journal(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(journal_module, "SIZE_BOUNDS", ("1 kB", "1 TB"))
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 100)
    journal = Journal(path, size="120 kB")
    [place] = await journal.open(["slow"])
    for at in range(5000):
        journal.put_readings(readings("a", float(at)))
        if at % 10 == 0:
            await asyncio.sleep(1)
    await asyncio.sleep(10)
    rows = in_journal(path)
    assert 100 < len(rows) < 9000
    assert place.dropped == 10_000 - len(rows)
    assert len(place) == len(rows)
    batches = []
    while batch := await place.take_polls(500, 0.1):
        batches += batch
        await place.confirm_readings(batch)
    assert [batch.id for batch in batches] == rows
    assert place.dropped == 10_000 - len(rows)
    await journal.close()
    assert [record.getMessage() for record in caplog.records] == [
        "slow: the journal is full; its oldest readings are dropped unconfirmed"
    ]


def test_the_identity_of_a_file_is_independent_of_its_folder(
    path: str, inline: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_for(path, 30, JsonOutput("readings.jsonl"))
    run_for(path, 30, JsonOutput(str(tmp_path / "readings.jsonl")))
    assert query(path, "SELECT output FROM place") == [(f"json {tmp_path}/readings.jsonl",)]


@in_simulated_time
async def test_a_journal_that_cannot_be_used_ends_the_fleet_before_it_polls(
    path: str, inline: None
) -> None:
    Path(path).write_text("not a journal")
    async with Peer() as peer:
        fleet = Fleet([meter("a", peer.url)], journal=Journal(path))
        with pytest.raises(JournalError, match=r"is not a journal$"):
            await fleet.run()
        assert peer.connections == []


async def test_a_journal_behind_a_link_is_the_same_journal(path: str, tmp_path) -> None:
    link = tmp_path / "link.db"
    link.symlink_to(path)
    journal = Journal(link)
    await journal.open([])
    with pytest.raises(JournalError, match="is used by another program"):
        await Journal(path).open([])
    journal.put_readings(readings("a", time.time()))
    await journal.close()
    assert len(in_journal(path)) == 2
    assert [sample.value for sample in Journal(link).history("a", "p1", 0, time.time())] == [0.1]
    assert {path.name for path in tmp_path.iterdir() if path.name.startswith("link")} == {link.name}


async def test_a_journal_belongs_to_one_fleet(path: str) -> None:
    journal = Journal(path)
    await journal.open([])
    with pytest.raises(RuntimeError, match="is already in use"):
        await journal.open([])
    with pytest.raises(JournalError, match="is used by another program"):
        await Journal(path).open([])
    await journal.close()
    await journal.close()


async def test_waiting_readings_are_written_when_the_fleet_ends(path: str) -> None:
    journal = Journal(path)
    await journal.open(["x"])
    batches = [journal.put_readings(readings("a", time.time() + at)) for at in range(1000)]
    await journal.close()
    assert journal.put_readings(readings()) == readings()  # nothing is expected any more
    last = batches[-1][-1].id
    rows = in_journal(path)
    assert len(rows) == 2000
    assert rows[-1] == last


async def test_a_cancelled_opening_leaves_the_file_to_others(path: str, monkeypatch) -> None:
    opening, goes_on = threading.Event(), threading.Event()
    original = JournalFile.open

    def slow(this: Any, *arguments: Any) -> Any:
        opening.set()
        goes_on.wait()
        return original(this, *arguments)

    monkeypatch.setattr(JournalFile, "open", slow)
    task = asyncio.create_task(Journal(path).open(["x"]))
    await until(opening.is_set)
    task.cancel()
    asyncio.get_running_loop().call_later(0.01, goes_on.set)
    with pytest.raises(asyncio.CancelledError):
        await task
    other = Journal(path)
    await other.open(["x"])
    await other.close()


async def test_a_blocked_disk_delays_no_poll(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hangs, goes_on = threading.Event(), threading.Event()
    write = JournalFile.write_polls

    def slow(this: Any, *arguments: Any) -> Any:
        if hangs.is_set():
            goes_on.wait()
        return write(this, *arguments)

    monkeypatch.setattr(JournalFile, "write_polls", slow)
    monkeypatch.setattr("libmodbus_py.services.fleet.journal.place.NOTING_S", 0.01)
    ids: list[int] = []

    journal = Journal(path)
    [place] = await journal.open(["broker"])
    hangs.set()
    for at in range(50):
        journal.put_readings(readings("a", time.time() + at))
        batch = await place.take_polls(100)
        ids.extend(reading.id for reading in batch)
        await place.confirm_readings(batch)
    goes_on.set()
    await journal.close()
    assert ids == in_journal(path)
    assert len(ids) == 100


@pytest.mark.parametrize("wrong", [{"keep": "90"}, {"size": "1 MB"}, {"path": ""}])
def test_wrong_arguments_are_named(wrong: dict[str, Any]) -> None:
    with pytest.raises((TypeError, ValueError), match="must be"):
        Journal(**{"path": "fleet.db", **wrong})
