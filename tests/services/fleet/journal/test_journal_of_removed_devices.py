"""
Devices all of whose readings were deleted: a journal forgets them when the next run begins.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time

from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import JournalReader, history
from libmodbus_py.services.fleet.journal.schema import JournalPoll, numbered
from tests.services.fleet.journal.journals import readings

KEEP = 1000.0


def opened(path: str, first: int = 0) -> tuple[JournalFile, int]:
    file = JournalFile(path, KEEP, 10**9)
    return file, file.open([], first).first


def poll(device: str, first: int, ago: float = 0, count: int = 2) -> JournalPoll:
    [made] = numbered(readings(device, time.time() - ago, count), first)
    return made


def names(path: str) -> dict[str, int]:
    """Return the devices in a journal, and how many points each has there: no others are there."""
    database = sqlite3.connect(path)
    asked = "SELECT name, (SELECT count(*) FROM point WHERE device = device.id) FROM device"
    rows = dict(database.execute(asked.replace("device = ", "point.device = ")).fetchall())
    [[points]] = database.execute("SELECT count(*) FROM point")
    database.close()
    assert points == sum(rows.values())
    return rows


def test_devices_without_readings_are_forgotten_with_their_points(path: str) -> None:
    file, first = opened(path)
    file.write([poll("gone", first, 2 * KEEP), poll("kept", first + 2)], {}, first + 3)
    assert names(path) == {"kept": 2, "gone": 2}  # its labels may be asked for in this run
    file.close()
    file, first = opened(path)
    assert names(path) == {"kept": 2}
    file.write([poll("other", first, count=3), poll("gone", first + 3)], {}, first)
    with contextlib.closing(JournalReader(path)) as reader:
        polls = reader.read(0, 99)
    read = [(each.readings[0].device, len(each.readings)) for each in polls]
    assert read == [("kept", 2), ("other", 3), ("gone", 2)]
    assert [each.value for each in history(path, "gone", "p1", 0, 1e12)] == [0.1]
    file.close()


def test_devices_whose_readings_wait_are_kept(path: str) -> None:
    """They are older than what is kept, and an output is away."""
    file, first = opened(path)
    file.write([poll("old", first, 2 * KEEP)], {}, 0)
    file.close()
    file, _ = opened(path)
    assert names(path) == {"old": 2}
    file.close()


def test_readings_keep_the_labels_of_their_time(path: str) -> None:
    file, first = opened(path)
    for at, site in enumerate(["x", "y", "x"]):
        given = poll("slow", first + 2 * at)
        labelled = [each._replace(labels={"site": site}) for each in given.readings]
        file.write([given._replace(readings=labelled)], {}, 0)
    with contextlib.closing(JournalReader(path)) as reader:
        read = [each.readings[0].labels["site"] for each in reader.read(0, 99)]
    assert read == ["x", "y", "x"]
    assert len(history(path, "slow", "p1", 0, 1e12)) == 3
    file.close()
