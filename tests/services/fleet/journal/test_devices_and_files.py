"""
Journals of devices that are removed, and files that are deleted or replaced while they are used.
"""

from __future__ import annotations

import contextlib
import math
import os
import time
from pathlib import Path

import pytest

from libmodbus_py import Fleet
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import history, past_in
from libmodbus_py.services.fleet.journal.schema import (
    JournalDamaged,
    JournalError,
    JournalPoll,
    numbered,
)
from tests.services.fleet.fleets import until
from tests.services.fleet.journal.journals import polls, readings
from tests.services.fleet.journal.test_journal import Broker, in_journal, run_for
from tests.tools.page.tables import Plant, visited

KEEP = 1000.0


def opened(path: str, first: int = 0) -> tuple[JournalFile, int]:
    file = JournalFile(path, KEEP, 10**9)
    return file, file.open([], first).first


def poll(device: str, first: int, ago: float = 0, count: int = 2) -> JournalPoll:
    [made] = numbered(readings(device, time.time() - ago, count), first)
    return made


def test_readings_keep_the_labels_of_their_time(path: str) -> None:
    file, first = opened(path)
    for at, site in enumerate(["x", "y", "x"]):
        given = poll("slow", first + 2 * at)
        labelled = [each._replace(labels={"site": site}) for each in given.readings]
        file.write([given._replace(readings=labelled)], {}, 0)
    read = [each.readings[0].labels["site"] for each in file.read(0, 99)]
    assert read == ["x", "y", "x"]
    assert len(history(path, "slow", "p1", 0, 1e12)) == 3
    file.close()


def delete(path: str, *endings: str) -> None:
    for each in endings:
        os.unlink(f"{path}{each}")


async def polled(broker: Broker, count: int) -> None:
    """Wait until an output has received so many more polls, in simulated time."""
    for _ in range(count):
        before = len(broker.ids)
        await until(lambda before=before: len(broker.ids) > before)  # type: ignore[misc]


@pytest.mark.usefixtures("inline")
@pytest.mark.parametrize("endings", [("", "-wal", "-shm"), ("", "-wal", "-shm", "-lock"), ("",)])
def test_a_journal_that_was_deleted_is_replaced(
    path: str, endings: tuple[str, ...], caplog: pytest.LogCaptureFixture
) -> None:
    broker, away = Broker(), Broker("away", is_away=True)

    async def lose(fleet: Fleet) -> None:
        delete(path, *endings)
        await polled(broker, 10)
        assert fleet.statistics.journal is not None
        assert fleet.statistics.journal.trouble == ""
        away.is_away = False
        await until(lambda: fleet.statistics.outputs["away"].waiting == 0)

    fleet = run_for(path, 100, broker, away, change=lose)
    kept = in_journal(path)
    assert kept == broker.ids[-len(kept) :]
    assert 15 <= len(kept) < len(broker.ids)
    # What was behind the last entry in memory is delivered, too.
    assert away.ids == broker.ids
    assert fleet.statistics.journal is not None
    assert fleet.statistics.journal.dropped == 0
    told = f"{path}: was deleted or replaced while it was in use; a new journal begins"
    assert caplog.text.count(told) == 1


@pytest.mark.usefixtures("inline")
def test_another_file_in_its_place_is_kept(path: str, tmp_path: Path) -> None:
    """Somebody has copied an older journal there, and has forgotten that the fleet runs."""
    run_for(path, 100, Broker())
    older = in_journal(path)
    copy = tmp_path / "copy.db"
    copy.write_bytes(Path(path).read_bytes())
    broker = Broker()

    async def restore(fleet: Fleet) -> None:
        os.rename(copy, path)
        await polled(broker, 10)

    run_for(path, 100, broker, change=restore)
    assert in_journal(f"{path}-damaged") == older
    kept = in_journal(path)
    assert kept == broker.ids[-len(kept) :] != []


def test_the_journal_of_another_program_in_its_place_is_left_alone(path: str) -> None:
    """All its files were deleted, and a second fleet was started."""
    first, second = JournalFile(path, 1e9, 10**9), JournalFile(path, 1e9, 10**9)
    with contextlib.closing(first), contextlib.closing(second):
        first.open([])
        first.write(polls(10**9, 3), {}, 0)
        delete(path, "", "-wal", "-shm", "-lock")
        second.open([])
        second.write(polls(10**9, 3), {}, 0)
        for _ in range(2):
            with pytest.raises(JournalError, match="was deleted or replaced"):
                first.write(polls(2 * 10**9, 3), {}, 0)
        with pytest.raises(JournalError, match="is used by another program"):
            first.replace(JournalDamaged("was deleted"), [])
        second.write(polls(3 * 10**9, 3), {}, 0)
        assert len(in_journal(path)) == 12


def test_a_page_shows_what_is_in_memory(path: str) -> None:
    file = JournalFile(path, 1e9, 10**9)
    plant = Plant(older=past_in(path))
    now = time.time()
    with contextlib.closing(file), visited(plant) as visitor:
        file.open([])
        file.write(polls(1, 3, time=now - 60), {}, 0)
        plant.describe(("a", "p1"), every=math.inf)
        plant.put("a", "p1", 5, at=now - 1)
        assert len(visitor.history(["a", "p1"], 100)["values"]) == 4
        delete(path, "", "-wal", "-shm")
        for _ in range(2):
            assert len(visitor.history(["a", "p1"], 100)["values"]) == 1
