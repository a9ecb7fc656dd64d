"""
The disk of a journal: it is full, damaged, hangs, or reports errors, and what was written is forced
onto it.
"""

from __future__ import annotations

import asyncio
import errno
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Journal, JournalError
from libmodbus_py.services.fleet.journal import place as recent
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.schema import JournalDamaged
from tests.services.fleet.fleets import LONGEST, in_simulated_time, until
from tests.services.fleet.journal.journals import Failing, Inline, in_journal, readings, run_for
from tests.support.outputs import Picky

HOUR = 3600.0


@pytest.mark.parametrize(
    ("name", "error", "logged"),
    [
        ("write", JournalError("fleet.db: the disk is full"), "fleet.db: the disk is full"),
        ("write", RuntimeError("a defect"), "RuntimeError: a defect"),  # with its traceback
        ("force", RuntimeError("a defect"), "RuntimeError: a defect"),
    ],
)
def test_what_fails_for_long_is_told_delays_no_output_and_loses_nothing(
    path: str,
    inline: None,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    name: str,
    error: Exception,
    logged: str,
) -> None:
    disk = Failing(monkeypatch, JournalFile, name, None)
    broker, away = Picky(), Picky("away", is_away=True)

    async def fail(fleet: Fleet) -> None:
        journal = fleet.statistics.journal
        assert journal is not None
        disk.error = error
        before = len(broker.ids)
        await asyncio.sleep(1000)
        assert len(broker.ids) >= before + 300 - 3
        await until(lambda: journal.trouble == str(error))
        assert journal.failures >= 30
        disk.error = None
        away.is_away = False
        await asyncio.sleep(60)
        assert (journal.trouble, journal.dropped) == ("", 0)
        assert fleet.statistics.outputs["away"].waiting == 0

    run_for(path, 100, broker, away, change=fail)
    assert broker.ids == away.ids == in_journal(path)
    assert logged in caplog.text
    if name == "write":  # after a failure to force, writes succeed, and the next failure is told
        assert caplog.text.count(logged) == 1
    assert "accepts readings again" in caplog.text


def test_a_disk_that_cannot_be_forced_is_reported_and_forced_again(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    forced: list[bool] = []
    error: list[OSError] = []

    def fsync(descriptor: int) -> None:
        forced.append(not error)
        if error:
            raise error[0]

    monkeypatch.setattr("libmodbus_py.services.fleet.journal.journal_file.os.fsync", fsync)
    broker = Picky()

    async def fail(fleet: Fleet) -> None:
        journal = fleet.statistics.journal
        assert journal is not None
        error.append(OSError(errno.EIO, "Input/output error"))
        await until(lambda: journal.trouble)
        assert journal.trouble == f"{path}: Input/output error"
        error.clear()
        await until(lambda: not journal.trouble)
        count = len(forced)
        await asyncio.sleep(6)
        assert any(forced[count:])  # although the device is polled each ten seconds only

    fleet = run_for(path, 100, broker, change=fail)
    assert fleet.statistics.journal is not None
    assert fleet.statistics.journal.dropped == 0
    assert broker.ids == in_journal(path)


def test_while_a_disk_is_full_for_long_memory_is_bounded(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(recent, "MOST_WAITING", 60)
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 60)
    disk = Failing(monkeypatch, JournalFile, "write", None)
    broker, away = Picky(), Picky("away", is_away=True)

    async def fill(fleet: Fleet) -> None:
        journal = fleet.statistics.journal
        assert journal is not None
        disk.error = JournalError("the disk is full")
        await asyncio.sleep(1000)
        disk.error = None
        away.is_away = False
        await asyncio.sleep(30)  # the longest pause between its tries
        await until(lambda: fleet.statistics.outputs["away"].waiting == 0)
        dropped = journal.dropped
        assert 200 < dropped < 300
        assert fleet.statistics.outputs["away"].dropped == dropped  # they were on no disk

    run_for(path, 100, broker, away, change=fill)
    assert len(broker.ids) == len({*broker.ids})  # this one had them from memory
    assert away.ids == in_journal(path)
    assert caplog.text.count("the oldest are dropped") == 1


def test_a_journal_that_is_damaged_while_it_is_used_is_replaced(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    disk = Failing(monkeypatch, JournalFile, "write", None)
    broker, away = Picky(), Picky("away", is_away=True)

    async def damage(fleet: Fleet) -> None:
        before = fleet.statistics.outputs["away"].waiting
        disk.error = JournalDamaged("fleet.db: is damaged")
        calls = disk.calls
        await until(lambda: disk.calls > calls)
        disk.error = None
        await asyncio.sleep(100)
        away.is_away = False
        await asyncio.sleep(30)  # the longest pause between its tries
        await until(lambda: fleet.statistics.outputs["away"].waiting == 0)
        # What was only in the damaged file is there still, but not for this output.
        assert fleet.statistics.outputs["away"].dropped in range(before - 9, before + 1)

    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 3)
    fleet = run_for(path, 300, broker, away, change=damage)
    old, new = in_journal(f"{path}-damaged"), in_journal(path)
    assert old + new == broker.ids
    assert away.ids == new
    assert fleet.statistics.journal is not None
    assert fleet.statistics.journal.dropped == 0
    assert caplog.text.count(f"is kept as {path}-damaged") == 1


def test_damage_that_a_reader_meets_is_healed_too(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = Failing(monkeypatch, JournalFile, "read", None)
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 3)
    away = Picky("away", is_away=True)

    async def damage(fleet: Fleet) -> None:
        reader.error = JournalDamaged("fleet.db: is damaged")
        away.is_away = False
        await asyncio.sleep(30)  # the longest pause between its tries
        await until(lambda: Path(f"{path}-damaged").exists())
        reader.error = None
        await asyncio.sleep(100)
        assert fleet.statistics.outputs["away"].waiting == 0

    run_for(path, 300, away, change=damage)
    assert away.ids[-30:] == in_journal(path)[-30:]


def test_a_damaged_journal_is_replaced_when_a_fleet_begins(
    path: str, inline: None, caplog: pytest.LogCaptureFixture
) -> None:
    run_for(path, 100, Picky())
    whole = bytearray(Path(path).read_bytes())
    whole[4096:] = b"\xff" * (len(whole) - 4096)
    Path(path).write_bytes(whole)
    broker = Picky()
    run_for(path, 100, broker)
    assert broker.ids == in_journal(path) != []
    assert Path(f"{path}-damaged").read_bytes() == bytes(whole)
    assert caplog.text.count("a new journal begins") == 1


def test_a_disk_that_reports_errors_to_a_reader_is_asked_again(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    reader = Failing(monkeypatch, JournalFile, "read", None)
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 3)
    away = Picky("away", is_away=True)

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


def test_a_disk_that_hangs_delays_nothing(path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    hangs, goes_on = threading.Event(), threading.Event()
    write = JournalFile.write

    def slow(this: Any, *arguments: Any) -> Any:
        if hangs.is_set():
            goes_on.wait()
        return write(this, *arguments)

    monkeypatch.setattr(JournalFile, "write", slow)
    monkeypatch.setattr("libmodbus_py.services.fleet.journal.place.NOTING_S", 0.01)
    ids: list[int] = []

    async def go() -> None:
        journal = Journal(path)
        [place] = await journal.open(["broker"])
        hangs.set()
        for at in range(50):
            journal.put(readings("a", time.time() + at))
            batch = await place.take_polls(100)
            ids.extend(each.id for each in batch)
            await place.confirm(batch)
        goes_on.set()
        await journal.close()

    asyncio.run(asyncio.wait_for(go(), 2 * LONGEST))
    assert ids == in_journal(path)
    assert len(ids) == 100


@in_simulated_time
async def test_an_output_gets_what_memory_has_dropped_when_it_is_in_the_file(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Although no readings follow that would wake it."""
    monkeypatch.setattr(recent, "MOST_IN_MEMORY", 4)
    journal = Journal(path)
    [place] = await journal.open(["broker"])
    journal.put(each for at in range(10) for each in readings("a", float(at)))
    found = await place.take_polls(100, timeout=HOUR)
    await journal.close()
    found = [each.id for each in found]
    assert found == in_journal(path)
    assert len(found) == 20


@in_simulated_time
async def test_each_poll_is_forced_onto_the_disk_although_none_follows(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        journal.put(readings("a", float(at)))
        await asyncio.sleep(0.45)
    await asyncio.sleep(5)
    await journal.close()
    written = [at for name, at in calls if name == "write"]
    assert len(written) == 4
    for each in written:
        forced = min(at for name, at in calls if name == "force" and at > each)
        assert forced - each <= 0.5 + 0.5 + 0.01  # until it begins, and what the disk takes


@in_simulated_time
async def test_what_was_written_is_forced_although_later_writes_fail(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = Failing(monkeypatch, JournalFile, "write", None)
    force = Failing(monkeypatch, JournalFile, "force", None)
    journal = Journal(path)
    await journal.open([])
    journal.put(readings("a", 1.0))
    await asyncio.sleep(0.1)
    disk.error = JournalError("the disk is full")
    journal.put(readings("a", 2.0))
    await asyncio.sleep(1)
    assert (force.calls, journal.statistics.trouble) == (1, "the disk is full")
    disk.error = None
    await journal.close()


@in_simulated_time
async def test_a_journal_without_readings_leaves_the_disk_alone(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Failing(monkeypatch, JournalFile, "write", None)
    force = Failing(monkeypatch, JournalFile, "force", None)
    journal = Journal(path)
    await journal.open([])
    journal.put(readings("a", 1.0))
    await asyncio.sleep(1000)
    assert force.calls == 1
    assert write.calls <= 4
    await journal.close()
