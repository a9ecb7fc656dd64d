"""The file of a journal: an SQLite database. Its methods block; one thread calls them."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

from ....protocol.json_text import SORTED_JSON
from ....protocol.logs import HarmlessLogger
from ....system import lock_file
from ..readings import NO_LABELS
from . import schema
from .schema import (
    JournalDamaged,
    JournalError,
    JournalPoll,
    Points,
    Row,
    decoded,
    encoded,
    journal_errors,
)

logger: HarmlessLogger = HarmlessLogger(__name__)

# Bytes of changes that are merged into the database at once: about a second on a slow disk.
MERGED_BYTES = 1 << 22

# Milliseconds to wait for a person who writes to the database.
BUSY_MS = 2000

# Polls that are deleted at once, so that no output waits long for its place to be written.
MOST_DELETED = 2000

# Polls deleted because of their age, at most, for each that is written: a clock that is wrong for
# an hour does not delete all.
DELETED_FOR_EACH = 10

# Pages of 4 kB that are given back to the system at once.
FREED = 500

INSERT_POLL = "INSERT OR IGNORE INTO poll VALUES (?, ?, ?, ?, ?, ?, ?, ?)"

NEWEST_POINTS = (
    "SELECT points, name, unit FROM point WHERE device = ?"
    " AND points = (SELECT max(points) FROM point WHERE device = ?) ORDER BY id"
)

POLLS = f"SELECT {', '.join(Row._fields)} FROM poll WHERE id > ? ORDER BY id"

POINTS = (
    "SELECT device.name, labels, point.name, unit"
    " FROM point JOIN device ON device.id = device WHERE points = ? ORDER BY point.id"
)

WAITING = """
SELECT confirmed, (SELECT CAST(total(readings) AS INTEGER) FROM poll WHERE poll.id > confirmed)
  FROM place WHERE output = ?
"""

SET_PLACE = (
    "INSERT INTO place VALUES (?, ?) ON CONFLICT DO UPDATE"
    " SET confirmed = max(confirmed, excluded.confirmed)"
)

# What the contents of a damaged row raise.
DAMAGES = (AttributeError, LookupError, TypeError, ValueError, RecursionError)


class RunStart(NamedTuple):
    """The first id of a run; for each output the id it confirmed, and how many readings wait."""

    first: int
    places: dict[str, tuple[int, int]]


class JournalState(NamedTuple):
    """The bytes of a journal; of each poll that was deleted, the first id and the readings."""

    size: int
    deleted: list[tuple[int, int]]


class JournalFile:
    """
    The file of a journal, while it is open.

    Readings are deleted `keep` seconds after they were read, if all outputs confirmed them, and
    beyond `size` bytes, confirmed or not.
    """

    def __init__(self, path: str, keep: float, size: int) -> None:
        # SQLite, too, puts its files beside the one that a link leads to; and so is the lock, which
        # is the same by whatever name the file is opened.
        self.path: str = os.path.realpath(path) if os.path.islink(path) else path
        self._keep = keep
        self._size = size
        self._lock = -1
        self._database: sqlite3.Connection | None = None
        # Device -> its labels and points in the last poll that was written.
        self._points: dict[str, tuple[Mapping[str, str], Points]] = {}
        # The same lists by their ids, for reading: name and labels of the device, names and units.
        self._lists: dict[int, tuple[str, Mapping[str, str], list[tuple[str, str]]]] = {}
        self._to_delete = 0.0
        self._identity: tuple[int, int] | None = None

    # --- life -------------------------------------------------------------------------------

    def open(self, outputs: Collection[str], first: int = 0) -> RunStart:
        """Open or create the file, and begin a run with the id `first`, 0 for one by the clock."""
        # Some other file must not be taken for a damaged journal, which is renamed.
        was_used = os.path.exists(f"{self.path}-lock")
        try:
            self._take_lock()
            with journal_errors(self.path):
                self._database = sqlite3.connect(
                    self.path, isolation_level=None, check_same_thread=False
                )
                self._prepare(self._database)
                state = self._begin(outputs, first)
        except JournalDamaged as error:
            self.close()
            if not was_used:
                raise JournalError(f"{self.path}: is not a journal") from error
            raise
        except BaseException:
            self.close()
            raise
        self._identity = _identity_of(self.path)
        return state

    def _take_lock(self) -> None:
        self._release_lock()  # its file may have been deleted, and another program have a new one
        path = f"{self.path}-lock"
        try:
            self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            lock_file(self._lock)
        except BlockingIOError:
            raise JournalError(f"{self.path}: is used by another program") from None
        except OSError as error:
            raise JournalError(f"{path}: {error.strerror}") from None

    def _release_lock(self) -> None:
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def _prepare(self, database: sqlite3.Connection) -> None:
        def pragma(text: str) -> int | str | None:
            row = database.execute(f"PRAGMA {text}").fetchone()
            return row[0] if row else None

        pragma(f"busy_timeout = {BUSY_MS}")
        [tables] = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
        kind, version = pragma("application_id"), pragma("user_version")
        if not tables:
            pragma("auto_vacuum = INCREMENTAL")
        elif kind != schema.APPLICATION:
            raise JournalError(f"{self.path}: is a database of another program")
        elif version != schema.VERSION:
            raise JournalError(
                f"{self.path}: is a journal of version {version}, and this program knows version"
                f" {schema.VERSION} only; name another file"
            )
        if pragma("journal_mode = WAL") != "wal":
            raise JournalError(f"{self.path}: its file system is not suitable for a journal")
        # `force` does both, for many transactions at once.
        pragma("synchronous = NORMAL")
        pragma("wal_autocheckpoint = 0")
        pragma(f"journal_size_limit = {1 << 26}")
        if not tables:
            # IMMEDIATE, else the tables are created one by one.
            database.executescript(
                f"BEGIN IMMEDIATE; PRAGMA application_id = {schema.APPLICATION};"
                f" PRAGMA user_version = {schema.VERSION}; {schema.SCHEMA} COMMIT"
            )

    def _begin(self, outputs: Collection[str], first: int) -> RunStart:
        database = self._used
        with self._transaction():
            [[read]] = database.execute("SELECT max(id + readings - 1) FROM poll")
            [[confirmed_id]] = database.execute("SELECT max(confirmed) FROM place")
            first = first or schema.first_id(time.time(), max(read or 0, confirmed_id or 0))
            # A new output begins with the next reading.
            database.executemany(
                "INSERT INTO place VALUES (?, ?) ON CONFLICT DO NOTHING",
                [(name, first - 1) for name in outputs],
            )
            places = {name: database.execute(WAITING, (name,)).fetchone() for name in outputs}
        return RunStart(first, places)

    def close(self) -> None:
        """Force all data onto the disk, close the file, and let others open it."""
        self._close_database("PRAGMA synchronous = FULL")
        self._release_lock()

    def _close_database(self, last: str = "") -> None:
        database, self._database = self._database, None
        self._points, self._lists = {}, {}
        if database is not None:
            with contextlib.suppress(sqlite3.Error), contextlib.closing(database):
                database.execute(last)

    def replace(self, error: JournalDamaged, outputs: Collection[str], first: int = 0) -> RunStart:
        """Rename a damaged file, and begin a new one, as `open` does."""
        self._close_database()
        self._take_lock()
        names = (f"{self.path}-damaged", *(f"{self.path}-damaged-{at}" for at in range(2, 1000)))
        new_name = next(name for name in names if not os.path.exists(name))
        # The changes of a database that is gone would spoil the one in its place.
        is_gone = self._identity not in (None, _identity_of(self.path))
        for ending in ("-wal", "-shm", ""):
            with journal_errors(self.path), contextlib.suppress(FileNotFoundError):
                if is_gone and ending:
                    os.unlink(f"{self.path}{ending}")
                else:
                    os.rename(f"{self.path}{ending}", f"{new_name}{ending}")
        if os.path.exists(new_name):
            logger.error("%s: is kept as %s", self.path, new_name)
        state = self.open(outputs, first)
        logger.error("%s; a new journal begins", error)
        return state

    @property
    def _used(self) -> sqlite3.Connection:
        if self._database is None:
            raise JournalError(f"{self.path}: is not open")
        return self._database

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        database = self._used
        database.execute("BEGIN IMMEDIATE")
        try:
            yield
            database.execute("COMMIT")
        except BaseException:
            self._points = {}  # some of these lists may not be in the file now
            with contextlib.suppress(sqlite3.Error):
                if database.in_transaction:
                    database.execute("ROLLBACK")
            raise

    # --- writing ----------------------------------------------------------------------------

    def write_polls(
        self, polls: Sequence[JournalPoll], places: Mapping[str, int], confirmed_id: int
    ) -> JournalState:
        """
        Write polls, and by output the last id that it confirmed, in one transaction or not at all,
        and delete what is too old. `confirmed` is the last id that all outputs confirmed.
        """
        with journal_errors(self.path):
            if _identity_of(self.path) != self._identity:  # its contents would be lost
                raise JournalDamaged(f"{self.path}: was deleted or replaced while it was in use")
            with self._transaction():
                rows = [row for poll in polls if (row := self._row(poll)) is not None]
                self._used.executemany(INSERT_POLL, rows)
                self._used.executemany(SET_PLACE, places.items())
            self._to_delete = min(1e6, self._to_delete + DELETED_FOR_EACH * len(rows))
            return self._delete(confirmed_id)

    def force(self) -> None:
        """Force what was written onto the disk, and merge it into the database if it is much."""
        wal = f"{self.path}-wal"
        with journal_errors(self.path):
            try:
                descriptor = os.open(wal, os.O_RDONLY | os.O_CLOEXEC)
            except FileNotFoundError:  # its contents are merged when the database is closed
                raise JournalDamaged(f"{wal}: was deleted while it was in use") from None
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
            if _size_of(wal) > MERGED_BYTES:
                self._used.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()

    def _row(self, poll: JournalPoll) -> Row | None:
        name, labels = poll.readings[0].device, poll.readings[0].labels
        entry = self._points.get(name)
        try:
            if entry is not None and entry[0] == labels:
                with contextlib.suppress(KeyError):
                    return encoded(poll, entry[1])
            points = self._points_of(name, labels, poll)
            self._points[name] = labels, points
            return encoded(poll, points)
        except (TypeError, ValueError, RecursionError) as error:
            logger.error("%s: a poll of %r is not written: %s", self.path, name, error)
            return None

    def _points_of(self, name: str, labels: Mapping[str, str], poll: JournalPoll) -> Points:
        """Return the newest list of the points of a device, or a new one if it lacks a point."""
        row = name, SORTED_JSON.encode(dict(labels))
        self._used.execute("INSERT OR IGNORE INTO device (name, labels) VALUES (?, ?)", row)
        [[device]] = self._used.execute("SELECT id FROM device WHERE (name, labels) = (?, ?)", row)
        rows = self._used.execute(NEWEST_POINTS, (device, device)).fetchall()
        number = rows[0][0] if rows else 0
        names = [(point, units) for _, point, units in rows]
        new = [(reading.name, reading.units) for reading in poll.readings]
        if not {*new} <= {*names}:
            [[number]] = self._used.execute("SELECT ifnull(max(id), 0) + 1 FROM point")
            names = [*dict.fromkeys([*new, *names])]
            self._used.executemany(
                "INSERT INTO point VALUES (?, ?, ?, ?, ?)",
                [(number + at, number, device, *pair) for at, pair in enumerate(names)],
            )
        return Points(number, device, {pair: at for at, pair in enumerate(names)})

    # --- reading ----------------------------------------------------------------------------

    def read_polls(self, after: int, most: int) -> list[JournalPoll]:
        """Return the polls behind an id, at least one if there is one, without damaged rows."""
        polls: list[JournalPoll] = []
        count = 0
        with (
            journal_errors(self.path),
            contextlib.closing(self._used.execute(POLLS, (after,))) as rows,
        ):
            for row in map(Row._make, rows):
                count += row.readings
                if polls and count > most:
                    break
                try:
                    polls.append(decoded(row, *self._list(row.points)))
                except DAMAGES as error:
                    logger.error("%s: poll %s cannot be read: %s", self.path, row.id, error)
        return polls

    def _list(self, number: int) -> tuple[str, Mapping[str, str], list[tuple[str, str]]]:
        if number not in self._lists:
            points = self._used.execute(POINTS, (number,)).fetchall()
            name, labels, *_ = points[0]
            names = [(point, units) for *_, point, units in points]
            self._lists[number] = name, json.loads(labels) or NO_LABELS, names
        return self._lists[number]

    # --- deleting ---------------------------------------------------------------------------

    def _delete(self, confirmed_id: int) -> JournalState:
        """Delete the oldest polls, if there are too many or they are too old."""
        [[page], [pages], [free]] = (
            self._used.execute(f"PRAGMA {name}").fetchone()
            for name in ("page_size", "page_count", "freelist_count")
        )
        excess = (pages - free) * page - self._size
        if excess > 0:
            polls = self._oldest(MOST_DELETED if excess > self._size / 20 else MOST_DELETED // 10)
        else:
            horizon = time.time() - self._keep
            oldest = self._oldest(int(min(MOST_DELETED, self._to_delete)), confirmed_id)
            polls = list(takewhile(lambda poll: poll[2] < horizon, oldest))
        if polls:
            with self._transaction():
                self._used.execute("DELETE FROM poll WHERE id <= ?", (polls[-1][0],))
            self._to_delete = max(0.0, self._to_delete - len(polls))
        if pages * page > self._size:
            # As a script, because `execute` ends after the first page.
            self._used.executescript(f"PRAGMA incremental_vacuum({FREED})")
        size = pages * page + _size_of(f"{self.path}-wal")
        return JournalState(size, [(first, count) for first, count, _ in polls])

    def _oldest(self, most: int, last: int = 1 << 62) -> list[tuple[int, int, float]]:
        return self._used.execute(
            "SELECT id, readings, time FROM poll WHERE id <= ? ORDER BY id LIMIT ?", (last, most)
        ).fetchall()


def _size_of(path: str) -> int:
    with contextlib.suppress(FileNotFoundError):
        return os.path.getsize(path)
    return 0


def _identity_of(path: str) -> tuple[int, int] | None:
    with contextlib.suppress(FileNotFoundError):
        status = os.stat(path)
        return status.st_dev, status.st_ino
    return None
