"""
The disk of a journal: it is full, damaged, hangs, or reports errors, and what was written is forced
onto it.
"""

import asyncio
import errno
import os
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Journal, JournalError
from libmodbus_py.services.fleet.journal import place as recent
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.schema import JournalDamaged
from tests.services.fleet.fleets import in_simulated_time, until
from tests.services.fleet.journal.journals import (
    Failing,
    Inline,
    in_journal,
    journal_of,
    readings,
    run_for,
)
from tests.support.outputs import FakeOutput

HOUR = 3600.0


pytestmark = pytest.mark.usefixtures("inline")

FULL = JournalError("fleet.db: the disk is full")
DAMAGED = JournalDamaged("fleet.db: is damaged")
DEFECT = RuntimeError("a defect")
BROKEN = OSError(errno.EIO, "Input/output error")


@pytest.mark.parametrize(
    ("kind", "name", "error", "reason"),
    [
        (JournalFile, "write_polls", FULL, "fleet.db: the disk is full"),
        (JournalFile, "write_polls", DEFECT, "a defect"),
        (JournalFile, "force", DEFECT, "a defect"),
        (os, "fsync", BROKEN, "fleet.db: Input/output error"),
    ],
)
def test_a_failing_disk_is_logged_and_delays_no_output_and_loses_no_reading(
    path: str, monkeypatch, caplog, kind, name, error, reason
) -> None:
    failing = Failing(monkeypatch, kind, name)
    broker, away = FakeOutput(), FakeOutput("away", is_away=True)

    async def fail(fleet: Fleet) -> None:
        journal = journal_of(fleet)
        failing.error = error
        before = len(broker.ids)
        await asyncio.sleep(1000)
        assert len(broker.ids) >= before + 300 - 3
        await until(lambda: journal.trouble.endswith(reason))
        assert journal.failures >= 30
        failing.error = None
        away.is_away = False
        await asyncio.sleep(60)
        assert (journal.trouble, journal.dropped) == ("", 0)
        assert fleet.statistics.outputs["away"].waiting == 0

    run_for(path, 100, broker, away, change=fail)
    assert broker.ids == away.ids == in_journal(path)
    # Once until something succeeds; after a failure to force, the next write does.
    logged = [record.getMessage() for record in caplog.records]
    failures = sum(record.endswith(reason) for record in logged)
    assert failures == logged.count(f"{path} accepts readings again") > 0
    assert ("Traceback" in caplog.text) is (error is DEFECT)


def test_memory_is_bounded_while_a_disk_is_full(
    path: str, disk: Failing, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recent, "MOST_WAITING", 60)
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 60)
    broker, away = FakeOutput(), FakeOutput("away", is_away=True)

    async def fill(fleet: Fleet) -> None:
        disk.error = FULL
        await asyncio.sleep(1000)
        disk.error = None
        await come_back(fleet, away)
        dropped = journal_of(fleet).dropped
        assert 200 < dropped < 300
        assert fleet.statistics.outputs["away"].dropped == dropped  # they were on no disk

    run_for(path, 100, broker, away, change=fill)
    assert len(broker.ids) == len({*broker.ids})  # this output had the readings from memory
    assert away.ids == in_journal(path)
    assert caplog.text.count("the oldest are dropped") == 1


async def come_back(fleet: Fleet, away: FakeOutput) -> None:
    """Let the output take readings again, until none waits."""
    away.is_away = False
    await asyncio.sleep(30)  # the longest pause between the output's attempts
    await until(lambda: fleet.statistics.outputs["away"].waiting == 0)


def test_a_journal_that_is_damaged_while_it_is_used_is_replaced(
    path: str, disk: Failing, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    broker, away = FakeOutput(), FakeOutput("away", is_away=True)

    async def damage(fleet: Fleet) -> None:
        before = fleet.statistics.outputs["away"].waiting
        disk.error = DAMAGED
        calls = disk.calls
        await until(lambda: disk.calls > calls)
        disk.error = None
        await asyncio.sleep(100)
        await come_back(fleet, away)
        # What was only in the damaged file is there still, but not for this output.
        assert fleet.statistics.outputs["away"].dropped in range(before - 9, before + 1)

    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 3)
    fleet = run_for(path, 300, broker, away, change=damage)
    old, new = in_journal(f"{path}-damaged"), in_journal(path)
    assert old + new == broker.ids
    assert away.ids == new
    assert journal_of(fleet).dropped == 0
    assert caplog.text.count(f"is kept as {path}-damaged") == 1


def test_damage_that_a_reader_finds_is_repaired_too(path: str, reader: Failing) -> None:
    away = FakeOutput("away", is_away=True)

    async def damage(fleet: Fleet) -> None:
        reader.error = DAMAGED
        away.is_away = False
        await asyncio.sleep(30)  # the longest pause between the output's attempts
        await until(lambda: Path(f"{path}-damaged").exists())
        reader.error = None
        await asyncio.sleep(100)
        assert fleet.statistics.outputs["away"].waiting == 0

    run_for(path, 300, away, change=damage)
    assert away.ids[-30:] == in_journal(path)[-30:]


def test_a_damaged_journal_is_replaced_when_a_fleet_begins(path: str, caplog) -> None:
    run_for(path, 100, FakeOutput())
    whole = bytearray(Path(path).read_bytes())
    whole[4096:] = b"\xff" * (len(whole) - 4096)
    Path(path).write_bytes(whole)
    broker = FakeOutput()
    run_for(path, 100, broker)
    assert broker.ids == in_journal(path) != []
    assert Path(f"{path}-damaged").read_bytes() == bytes(whole)
    assert caplog.text.count("a new journal begins") == 1


def test_a_disk_that_reports_errors_to_a_reader_is_asked_again(path: str, reader: Failing, caplog):
    away = FakeOutput("away", is_away=True)

    async def read(fleet: Fleet) -> None:
        reader.error = JournalError("the disk reports an error")
        away.is_away = False
        await asyncio.sleep(100)
        assert 10 < reader.calls < 250
        assert "the disk reports an error" in caplog.text
        reader.error = None
        await until(lambda: fleet.statistics.outputs["away"].waiting == 0)

    fleet = run_for(path, 300, away, change=read)
    assert away.ids == in_journal(path)
    assert fleet.statistics.outputs["away"].dropped == 0


@in_simulated_time
async def test_an_output_gets_dropped_readings_once_they_are_in_the_file(
    path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Although no readings follow that would wake it."""
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 4)
    journal = Journal(path)
    [place] = await journal.open(["broker"])
    journal.put_readings(reading for at in range(10) for reading in readings("a", float(at)))
    ids = await place.take_polls(100, timeout=HOUR)
    await journal.close()
    ids = [id_.id for id_ in ids]
    assert ids == in_journal(path)
    assert len(ids) == 20


@in_simulated_time
async def test_each_poll_is_forced_to_the_disk_although_none_follows(path: str, monkeypatch):
    calls: list[tuple[str, float]] = []
    call = Inline.call

    async def slowly(thread: Any, function: Any, *arguments: Any) -> Any:
        if function.__name__ == "force":  # one poll comes while the disk is being forced
            await asyncio.sleep(0.5)
        if function.__name__ == "force" or arguments[:1] not in ((), ([],)):
            calls.append((function.__name__, asyncio.get_running_loop().time()))
        return await call(thread, function, *arguments)

    monkeypatch.setattr(Inline, "call", slowly)
    journal = Journal(path)
    await journal.open([])
    for at in range(4):
        journal.put_readings(readings("a", float(at)))
        await asyncio.sleep(0.45)
    await asyncio.sleep(5)
    await journal.close()
    times = [at for name, at in calls if name == "write_polls"]
    assert len(times) == 4
    for time_ in times:
        forced = min(at for name, at in calls if name == "force" and at > time_)
        assert forced - time_ <= 0.5 + 0.5 + 0.01  # until it begins, and what the disk takes


@in_simulated_time
async def test_written_polls_are_forced_to_the_disk_although_later_writes_fail(
    path: str, disk: Failing, monkeypatch: pytest.MonkeyPatch
) -> None:
    force = Failing(monkeypatch, JournalFile, "force")
    journal = Journal(path)
    await journal.open([])
    journal.put_readings(readings("a", 1.0))
    await asyncio.sleep(0.1)
    disk.error = FULL
    journal.put_readings(readings("a", 2.0))
    await asyncio.sleep(1)
    assert (force.calls, journal.statistics.trouble) == (1, str(FULL))
    disk.error = None
    await journal.close()


@in_simulated_time
async def test_a_journal_without_readings_does_not_access_the_disk(
    path: str, disk: Failing, monkeypatch: pytest.MonkeyPatch
) -> None:
    force = Failing(monkeypatch, JournalFile, "force")
    journal = Journal(path)
    await journal.open([])
    journal.put_readings(readings("a", 1.0))
    await asyncio.sleep(1000)
    assert force.calls == 1
    assert disk.calls <= 4
    await journal.close()
