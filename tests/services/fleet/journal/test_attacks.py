"""Journals under attack: programs that are killed, disks that fail, clocks, defects, and floods."""

import asyncio
import contextlib
import os
import random
import shutil
import signal
import sqlite3
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from fuzz.journal_trial import Found, KilledPolls, devices
from fuzz.journal_trial import until as until_really
from libmodbus_py import Fleet
from libmodbus_py.fleet import Journal
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.schema import JournalDamaged, JournalError
from libmodbus_py.services.fleet.outputs.writer import MOST_OF_JOURNAL
from tests.services.fleet.fleets import NETWORK, Peer, in_simulated_time, meter, until
from tests.services.fleet.journal.journals import (
    Failing,
    in_journal,
    journal_of,
    polls,
    query,
    run_for,
)
from tests.support.outputs import FakeOutput


def opened(path: str, size: int = 10**9) -> JournalFile:
    file = JournalFile(path, 1e10, size)
    file.open(["a"], 1)
    return file


def test_a_program_killed_at_any_step_of_a_transaction_loses_no_reading(path: str, tmp_path: Path):
    """What is on the disk at each step is a journal with whole polls, and a place among them."""
    copies: list[Path] = []

    def copy(statement: str) -> None:
        folder = tmp_path / f"{len(copies)}"
        folder.mkdir()
        for ending in ("", "-wal"):
            shutil.copy(f"{path}{ending}", folder / f"fleet.db{ending}")
        copies.append(folder / "fleet.db")

    file = opened(path)
    file._used.set_trace_callback(copy)
    for at in range(3):
        file.write_polls(polls(1 + 20 * at, 10), {"a": 20 * at}, 20 * at)
        file.force()
    file._used.set_trace_callback(None)
    file.close()
    assert len(copies) > 30
    states = set()
    for entry in copies:
        again = JournalFile(str(entry), 1e10, 10**9)
        contents = again.open(["a"])
        confirmed, _ = contents.places["a"]
        again.write_polls([], {"a": confirmed}, 0)
        again.close()
        ids = in_journal(str(entry))
        assert ids == [*range(1, len(ids) + 1)]
        assert confirmed <= len(ids) < contents.first
        states.add((len(ids), confirmed))
    assert states == {(0, 0), (20, 0), (40, 20), (60, 40)}


def test_an_error_while_a_journal_closes_leaves_the_file_usable(
    path: str, inline: None, disk: Failing, caplog: pytest.LogCaptureFixture
) -> None:
    async def fail(fleet: Fleet) -> None:
        disk.error = RuntimeError("a defect")
        await asyncio.sleep(10)

    fleet = run_for(path, 100, FakeOutput(), change=fail)
    disk.error = None
    assert journal_of(fleet).dropped > 0
    assert "readings are lost" in caplog.text
    run_for(path, 100, FakeOutput())


@in_simulated_time
async def test_a_clock_set_back_loses_and_repeats_no_reading(
    path: str, inline: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    broker, away = FakeOutput(), FakeOutput("away", is_away=True)
    shift = [0.0]
    now = NETWORK.get().time_of_day
    monkeypatch.setattr(time, "time", lambda: now() + shift[0])
    async with Peer() as peer:
        devices = [meter("a", peer.url, interval=1)]
        journal = Journal(path, keep="1 minute")
        async with Fleet(devices, outputs=[broker, away], journal=journal):
            for back in (0.0, -3600.0, -86_400.0):
                shift[0] = back
                await asyncio.sleep(20)
            away.is_away = False
            await asyncio.sleep(40)
    assert broker.ids == away.ids == sorted(set(broker.ids))
    assert len(broker.ids) > 250


@in_simulated_time
async def test_a_reload_during_transactions_loses_and_repeats_no_reading(
    path: str, inline: None
) -> None:
    """Also with `on_change`, and after failed transactions: no list of points grows."""
    broker = FakeOutput()
    async with Peer() as one, Peer() as two:
        journal = Journal(path)
        fleet = Fleet([], outputs=[broker], journal=journal)
        async with fleet:
            for at in range(60):
                devices = [
                    meter(name, peer.url, on_change=at % 2 == 0, labels={"run": f"{at % 3}"})
                    for name, peer in (("a", one), ("b", two))
                ]
                fleet.replace(devices[: 1 + at % 2])
                await asyncio.sleep(0.03 * (at % 7))
    assert broker.ids == in_journal(path)
    # Three points of two devices with three sets of labels.
    assert query(path, "SELECT count(*) FROM point")[0][0] <= 18


@pytest.mark.parametrize(
    "change",
    [
        lambda batch: batch.clear(),
        lambda batch: batch.reverse(),
        lambda batch: batch.extend([reading._replace(id=reading.id + 10**6) for reading in batch]),
    ],
    ids=["clears", "reverses", "extends"],
)
def test_an_output_that_changes_its_list_of_readings_loses_none(path: str, inline: None, change):
    class Changing(FakeOutput):
        async def write_readings(self, readings: Any) -> None:
            await super().write_readings(list(readings))
            change(readings)

    broker = Changing()
    run_for(path, 100, broker)
    again = FakeOutput()
    run_for(path, 100, again)
    assert (broker.ids + again.ids) == in_journal(path)


KILLS = 3


def confirmed(polls: KilledPolls) -> int:
    with suppress(sqlite3.Error, ValueError):  # the journal is being created
        return min(polls.places().values())
    return 0


async def test_a_killed_poll_process_loses_no_reading_in_the_journal(tmp_path: Path) -> None:
    async with devices(5) as urls:
        polls = KilledPolls(tmp_path, urls, interval=0.05)
        for _ in range(KILLS):
            with polls.running():
                size = polls.size + random.randint(1, 50_000)
                await until_really(lambda size=size: polls.size > size)  # type: ignore[misc]
        last = polls.in_journal()[-1]
        with polls.running() as process:
            await until_really(lambda: confirmed(polls) > last and len(polls.in_journal()) > 100)
            process.send_signal(signal.SIGTERM)
            assert await asyncio.to_thread(process.wait) == 0
    arrived, journal = polls.in_file(), polls.in_journal()
    result = Found(journal, confirmed(polls), arrived)
    assert result.lost == 0
    assert result.repeated <= KILLS * (MOST_OF_JOURNAL + 10)
    assert confirmed(polls) == journal[-1]


def delete(path: str, *endings: str) -> None:
    for ending in endings:
        os.unlink(f"{path}{ending}")


async def poll_all(broker: FakeOutput, count: int) -> None:
    """Wait until an output has received so many more polls, in simulated time."""
    for _ in range(count):
        before = len(broker.ids)
        await until(lambda before=before: len(broker.ids) > before)  # type: ignore[misc]


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("endings", [("", "-wal", "-shm"), ("", "-wal", "-shm", "-lock"), ("",)])
def test_a_journal_that_was_deleted_is_replaced(path: str, endings, caplog) -> None:
    broker, away = FakeOutput(), FakeOutput("away", is_away=True)

    async def lose(fleet: Fleet) -> None:
        delete(path, *endings)
        await poll_all(broker, 10)
        assert journal_of(fleet).trouble == ""
        away.is_away = False
        await until(lambda: fleet.statistics.outputs["away"].waiting == 0)

    fleet = run_for(path, 100, broker, away, change=lose)
    rows = in_journal(path)
    assert rows == broker.ids[-len(rows) :]
    assert 15 <= len(rows) < len(broker.ids)
    # Readings after the last entry in memory are delivered, too.
    assert away.ids == broker.ids
    assert journal_of(fleet).dropped == 0
    message = f"{path}: was deleted or replaced while it was in use; a new journal begins"
    assert caplog.text.count(message) == 1


@pytest.mark.usefixtures("inline")
def test_a_journal_that_lost_its_file_of_changes_is_kept(path: str, caplog) -> None:
    """The changes are in the file -wal, which is merged once it is closed."""
    broker = FakeOutput()

    async def lose(fleet: Fleet) -> None:
        delete(path, "-wal")
        await poll_all(broker, 10)

    run_for(path, 100, broker, change=lose)
    assert in_journal(f"{path}-damaged") + in_journal(path) == broker.ids
    assert caplog.text.count(f"is kept as {path}-damaged") == 1


@pytest.mark.usefixtures("inline")
def test_another_file_at_the_path_of_the_journal_is_kept(path: str, tmp_path: Path) -> None:
    """Somebody has copied an older journal there, and has forgotten that the fleet runs."""
    run_for(path, 100, FakeOutput())
    older = in_journal(path)
    copy = tmp_path / "copy.db"
    copy.write_bytes(Path(path).read_bytes())
    broker = FakeOutput()

    async def restore(fleet: Fleet) -> None:
        os.rename(copy, path)
        await poll_all(broker, 10)

    run_for(path, 100, broker, change=restore)
    assert in_journal(f"{path}-damaged") == older
    rows = in_journal(path)
    assert rows == broker.ids[-len(rows) :] != []


def test_the_journal_of_another_program_at_the_path_is_left_alone(path: str) -> None:
    """All files of the journal were deleted, and a second fleet was started."""
    first, second = JournalFile(path, 1e9, 10**9), JournalFile(path, 1e9, 10**9)
    with contextlib.closing(first), contextlib.closing(second):
        first.open([])
        first.write_polls(polls(10**9, 3), {}, 0)
        delete(path, "", "-wal", "-shm", "-lock")
        second.open([])
        second.write_polls(polls(10**9, 3), {}, 0)
        for _ in range(2):
            with pytest.raises(JournalError, match="was deleted or replaced"):
                first.write_polls(polls(2 * 10**9, 3), {}, 0)
        with pytest.raises(JournalError, match="is used by another program"):
            first.replace(JournalDamaged("was deleted"), [])
        second.write_polls(polls(3 * 10**9, 3), {}, 0)
        assert len(in_journal(path)) == 12
