"""
The file of a journal: what is written is read, by us and by a person with SQL, and what cannot be
used is refused in one line.
"""

import os
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.journal import journal_file
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import history
from libmodbus_py.services.fleet.journal.schema import (
    MARGIN,
    JournalDamaged,
    JournalError,
    JournalPoll,
    numbered,
)
from tests.services.fleet.journal.journals import polls, query, readings

DAY = 86_400.0


def opened(path: str, *outputs: str, keep: float = 90 * DAY, size: int = 10**9) -> JournalFile:
    file = JournalFile(path, keep, size)
    file.open(outputs)
    return file


@pytest.fixture
def file(path: str) -> Iterator[JournalFile]:
    journal = opened(path, "a", "b")
    yield journal
    journal.close()


def test_polls_are_read_as_they_were_written(file: JournalFile) -> None:
    every = polls(1000, 10)
    file.write_polls(every[:7], {}, 0)
    file.write_polls(every[7:], {}, 0)
    bad = readings("a", 2000.0)[0]._replace(value=None, quality="bad", reason="Missing")
    single = list(numbered([bad], 1020))
    file.write_polls(single, {}, 0)
    for _ in range(2):
        assert file.read_polls(999, 1000) == every + single
        assert file.read_polls(1003, 5) == every[2:4]
        assert file.read_polls(1020, 1000) == []
        file.close()
        file.open([])


def test_a_poll_that_is_written_again_exists_once(file: JournalFile) -> None:
    file.write_polls(polls(1, 2), {}, 0)
    file.write_polls(polls(1, 3), {}, 0)
    assert query(file.path, "SELECT id FROM poll") == [(1,), (3,), (5,)]


def test_the_tables_of_the_file_have_names_and_units_and_labels(file: JournalFile) -> None:
    hostile = "'; DROP TABLE poll; --"
    rows = [
        Reading(0.5, hostile, 'a"b', 230.5, "V", "good", labels={"site": "north"}),
        Reading(
            0.5, hostile, "$.x[0]", None, "", "bad", "IllegalDataAddress", labels={"site": "north"}
        ),
        Reading(0.5, hostile, "on", True, "", "good", labels={"site": "north"}),
        Reading(0.5, hostile, "list", [1, 2], "", "good", labels={"site": "north"}),
    ]
    later = [rows[2]._replace(time=1.5, value=False), rows[0]._replace(time=1.5, value="x")]
    file.write_polls([*numbered(rows, 10), *numbered(later, 20)], {}, 0)
    columns = "id, time, device, name, value, unit, quality, reason, labels, seconds"
    at, labels = "1970-01-01T00:00:00.500Z", '{"site":"north"}'
    assert query(file.path, f"SELECT {columns} FROM reading ORDER BY id") == [
        (10, at, hostile, 'a"b', 230.5, "V", "good", "", labels, 0.5),
        (11, at, hostile, "$.x[0]", None, "", "bad", "IllegalDataAddress", labels, 0.5),
        (12, at, hostile, "on", 1, "", "good", "", labels, 0.5),
        (13, at, hostile, "list", "[1,2]", "", "good", "", labels, 0.5),
        (20, "1970-01-01T00:00:01.500Z", hostile, "on", 0, "", "good", "", labels, 1.5),
        (21, "1970-01-01T00:00:01.500Z", hostile, 'a"b', "x", "V", "good", "", labels, 1.5),
    ]


def test_a_query_for_one_device_uses_the_index(file: JournalFile) -> None:
    plan = query(
        file.path, "EXPLAIN QUERY PLAN SELECT * FROM reading WHERE device = 'a' AND seconds > 5"
    )
    assert any("poll_of_device (device=? AND time>?)" in str(row) for row in plan), plan


def some(first: int, *names: str, site: str = "north") -> list[JournalPoll]:
    """A poll of a device in which only these points have changed."""
    labels = {"site": site}
    changed = [Reading(first / 1e3, "a", name, first, "V", "good", labels=labels) for name in names]
    return list(numbered(changed, first))


def test_readings_keep_the_labels_they_had(file: JournalFile) -> None:
    for at, site in enumerate(["x", "y", "x"]):
        file.write_polls(some(1 + at, "p0", site=site), {}, 0)
    read = [read_poll.readings[0].labels["site"] for read_poll in file.read_polls(0, 99)]
    assert read == ["x", "y", "x"]
    assert len(history(file.path, "a", "p0", 0, 9)) == 3


def test_a_history_reads_polls_with_other_points_of_a_device(file: JournalFile) -> None:
    file.write_polls(some(1, "p0", "p1"), {}, 0)
    file.write_polls(some(3, "p0"), {}, 0)
    assert query(file.path, "SELECT chosen FROM poll") == [(None,), (None,)]
    assert [sample.value for sample in history(file.path, "a", "p1", 0, 9)] == [1]
    assert [sample.value for sample in history(file.path, "a", "p0", 0, 9)] == [1, 3]


@pytest.mark.parametrize("names", [("p0", "p1"), ("p1",)])
def test_a_history_has_numbers_and_text(file: JournalFile, names: tuple[str, ...]) -> None:
    """Also of polls of some points."""
    file.write_polls(some(1, "p0", "p1"), {}, 0)
    for first, value in ((3, True), (5, [1, None]), (7, {"a": False})):
        [poll] = some(first, *names)
        changed = [reading._replace(value=value) for reading in poll.readings]
        file.write_polls([poll._replace(readings=changed)], {}, 0)
    values = [sample.value for sample in history(file.path, "a", "p1", 0, 9)]
    assert list(map(repr, values)) == ["1", "1", "'[1,null]'", "'{\"a\":false}'"]


def test_a_poll_that_cannot_be_written_does_not_delay_others(file: JournalFile, caplog) -> None:
    strange = Reading(1.0, "b", "p0", object(), "", "good")
    nameless = strange._replace(device="\ud800", value=1)
    file.write_polls(
        [*polls(1, 1), *numbered([strange], 3), *numbered([nameless], 4), *polls(5, 1)], {}, 0
    )
    assert query(file.path, "SELECT id FROM poll") == [(1,), (5,)]
    assert "a poll of 'b' is not written: Object of type object" in caplog.text
    assert "a poll of '\\ud800' is not written: 'utf-8' codec" in caplog.text


def test_places_are_kept_for_each_output(path: str) -> None:
    file = JournalFile(path, DAY, 10**9)
    first = file.open(["a"])
    assert first.places == {"a": (first.first - 1, 0)}
    file.write_polls(polls(first.first, 5), {"a": first.first + 3}, 0)
    file.write_polls([], {"a": first.first + 1}, 0)  # a place never falls
    file.close()
    second = file.open(["a", "new"])
    assert second.first >= first.first + 9 + MARGIN or second.first > first.first + 10
    assert second.places == {"a": (first.first + 3, 6), "new": (second.first - 1, 0)}
    file.close()
    file.open(["new"])  # an output that is not connected keeps its place
    file.close()
    assert dict(query(path, "SELECT * FROM place"))["a"] == first.first + 3


@pytest.mark.parametrize("now", [0.0, 4e9])
def test_ids_rise_whatever_the_time_of_day(path: str, now, monkeypatch) -> None:
    file = JournalFile(path, DAY, 10**9)
    contents = file.open([])
    file.write_polls(polls(contents.first, 5), {}, 0)
    file.close()
    monkeypatch.setattr(journal_file, "time", SimpleNamespace(time=lambda: now, monotonic=float))
    assert file.open([]).first >= contents.first + 9 + MARGIN
    file.close()


def test_old_readings_are_deleted_after_all_outputs_confirmed_them(path: str) -> None:
    file = opened(path, "a", keep=100.0)
    old, now = polls(1, 10, time=time.time() - 1000), polls(21, 10, time=time.time())
    assert file.write_polls([*old, *now], {}, 8).deleted[-1] == (
        7,
        2,
    )  # later readings wait for an output
    assert file.write_polls([], {}, 40).deleted[-1] == (19, 2)
    assert file.write_polls([], {}, 40).deleted == []
    assert query(path, "SELECT min(id), count(*) FROM poll") == [(21, 10)]
    file.close()


@pytest.mark.parametrize("now", [0.0, 4e9])
def test_a_clock_that_is_wrong_for_a_while_deletes_few_readings(path: str, now, monkeypatch):
    file = opened(path, keep=90 * DAY)
    file.write_polls(polls(1, 1000, time=time.time()), {}, 10_000)
    file._to_delete = 0  # the deletions that these allowed were made long ago
    monkeypatch.setattr(journal_file, "time", SimpleNamespace(time=lambda: now, monotonic=float))
    file.write_polls(polls(5001, 3, time=now), {}, 10_000)
    [[count]] = query(path, "SELECT count(*) FROM poll WHERE id < 5000")
    assert count == (970 if now else 1000)
    file.close()


def test_the_oldest_readings_are_deleted_at_the_limit_confirmed_or_not(path: str) -> None:
    size = 200_000
    file = opened(path, "a", size=size)
    first, deleted = 1, 0
    for _ in range(100):
        result = file.write_polls(polls(first, 100, time=time.time()), {}, 0)
        first += 200
        while result.deleted:
            deleted = sum(result.deleted[-1]) - 1
            result = file.write_polls([], {}, 0)
    [[oldest, count]] = query(path, "SELECT min(id), count(*) FROM poll")
    assert oldest == deleted + 1
    assert 500 < count < 10_000
    file.close()
    assert os.path.getsize(path) < 1.2 * size


def test_a_file_above_a_new_limit_becomes_smaller(path: str) -> None:
    file = opened(path)
    for at in range(50):
        file.write_polls(polls(1 + 1000 * at, 500, time=time.time()), {}, 0)
    file.close()
    before = os.path.getsize(path)
    file = opened(path, size=100_000)
    while file.write_polls([], {}, 0).deleted:
        pass
    for _ in range(20):
        file.write_polls([], {}, 0)
    file.close()
    assert os.path.getsize(path) < 200_000 < before


def refused(path: str) -> str:
    with pytest.raises(JournalError) as error:
        JournalFile(path, DAY, 10**9).open(["a"])
    assert "\n" not in str(error.value)
    return str(error.value).removeprefix(path)


def test_a_journal_of_another_version_is_refused(path: str) -> None:
    opened(path).close()
    database = sqlite3.connect(path)
    database.execute("PRAGMA user_version = 7")
    database.close()
    assert refused(path) == (
        ": is a journal of version 7, and this program knows version 1 only; name another file"
    )


def test_a_database_of_another_program_is_refused_and_not_changed(path: str) -> None:
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE reading (id)")
    database.close()
    before = Path(path).read_bytes()
    assert refused(path) == ": is a database of another program"
    assert Path(path).read_bytes() == before


def test_a_file_that_is_no_database_is_refused_and_not_changed(path: str) -> None:
    Path(path).write_text("time,device,name\n" * 100)
    assert refused(path) == ": is not a journal"
    assert Path(path).read_text() == "time,device,name\n" * 100


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    path = str(tmp_path / "none" / "fleet.db")
    assert refused(path) == "-lock: No such file or directory"


def test_a_full_disk_changes_nothing(file: JournalFile) -> None:
    file.write_polls(polls(1, 10), {"a": 1 << 60}, 0)
    [[pages]] = file._used.execute("PRAGMA page_count")
    file._used.execute(f"PRAGMA max_page_count = {pages}").fetchall()
    many = polls(21, 5000)
    with pytest.raises(JournalError, match=r"the disk is full$"):
        file.write_polls(many, {"a": 1 << 61}, 0)
    assert query(file.path, "SELECT count(*), max(id) FROM poll") == [(10, 19)]
    assert dict(query(file.path, "SELECT * FROM place"))["a"] == 1 << 60
    file._used.execute("PRAGMA max_page_count = 1000000").fetchall()
    file.write_polls(many, {"a": 9}, 0)
    assert query(file.path, "SELECT count(*) FROM poll") == [(5010,)]


def test_each_damaged_file_keeps_a_name_of_its_own(path: str) -> None:
    for _ in range(3):
        file = opened(path)
        file.replace(JournalDamaged("is damaged"), [])
        file.close()
    names = [f"{path}-damaged", f"{path}-damaged-2", f"{path}-damaged-3"]
    assert all(Path(name).exists() for name in names)


def test_a_damaged_row_is_left_out(file: JournalFile, caplog: pytest.LogCaptureFixture) -> None:
    every = polls(1, 5)
    file.write_polls(every, {}, 0)
    for number, column, text in ((3, "data", "[1"), (5, "data", "[1]"), (7, "trouble", "[]")):
        file._used.execute(f"UPDATE poll SET {column} = ? WHERE id = ?", (text, number))
    assert file.read_polls(0, 100) == [every[0], every[4]]
    assert caplog.text.count("cannot be read") == 3


def test_a_history_is_read_while_the_journal_is_written(file: JournalFile) -> None:
    file.write_polls(polls(1, 100), {}, 0)
    some = [reading._replace(time=300.0, value=9.5) for reading in readings()[1:]]
    bad = [item._replace(time=301.0, value=None, quality="bad") for item in reversed(readings())]
    file.write_polls([*numbered(some, 500), *numbered(bad, 502)], {}, 0)
    rows = history(file.path, "a", "p1", 150.0, 1000.0)
    assert [row.time for row in rows] == [*map(float, range(150, 200)), 300.0, 301.0]
    assert [tuple(row)[1:] for row in rows[-3:]] == [(0.1, "good"), (9.5, "good"), (None, "bad")]
    assert history(file.path, "a", "p0", 299.0, 300.0) == []
    assert history(file.path, "a", "none", 0.0, 1000.0) == []
    assert len(history(file.path, "a", "p1", 0.0, 1000.0, most=9)) <= 9
