"""
The file of a journal: an SQLite database. Its methods block; one thread calls them.

::

    device (id, name, labels)               labels in JSON; a row for each set of labels
    point  (id, points, device, name, unit) `points` is the id of the first point of its list
    poll   (id, readings, time, device, points, chosen, data, trouble)       see `polls.Row`
    place  (output, confirmed)              the last reading that each output has confirmed
    run    (first, unused)                  see `numbers.Unused`
    reading                                 a view: one row for each reading
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import takewhile
from typing import NamedTuple

from ....protocol.json_text import SORTED_JSON
from ....protocol.logs import HarmlessLogger
from ....system import lock_file
from .errors import JournalDamaged, JournalError, raised
from .numbers import first_id
from .polls import JournalPoll, Points, Row, encoded

__all__ = ["Begun", "JournalFile", "JournalState", "force"]

logger: HarmlessLogger = HarmlessLogger(__name__)

# In the header of the file; `file` and other programs name the kind of a database by it.
APPLICATION = 0x4D424A31
VERSION = 1

# Bytes of changes that are merged into the database at once.
MERGED = 1 << 22

# Milliseconds to wait for a person who writes to the database.
BUSY = 2000

# Polls that are deleted at once, so that no output waits long for its place to be written.
MOST_DELETED = 2000

# Polls deleted because of their age, at most, for each that is written: a clock that is wrong for
# an hour does not delete all.
DELETED_FOR_EACH = 10

# Pages that are given back to the system at once.
FREED = 500

# Bytes of changes that a person who reads for hours may keep from being merged.
LARGEST_WAL = 1 << 27

Identity = tuple[int, int]
"""Device and inode of a file."""

WITH_IDENTITY = ("", "-wal")
"""Ends of the names of files without which a journal is lost: the database and its changes."""

SCHEMA = """
CREATE TABLE device (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL,
    labels TEXT NOT NULL DEFAULT '{}',
    UNIQUE (name, labels)
);
CREATE TABLE point (
    id INTEGER PRIMARY KEY,
    points INTEGER NOT NULL,
    device INTEGER NOT NULL REFERENCES device,
    name TEXT NOT NULL,
    unit TEXT NOT NULL
);
CREATE INDEX point_of_device ON point (device, points);
CREATE TABLE poll (
    id INTEGER PRIMARY KEY,
    readings INTEGER NOT NULL,
    time REAL NOT NULL,
    device INTEGER NOT NULL REFERENCES device,
    points INTEGER NOT NULL REFERENCES point,
    chosen TEXT,
    data TEXT NOT NULL,
    trouble TEXT
);
CREATE INDEX poll_of_device ON poll (device, time);
CREATE TABLE place (
    output TEXT PRIMARY KEY,
    confirmed INTEGER NOT NULL
) WITHOUT ROWID;
CREATE TABLE run (
    first INTEGER PRIMARY KEY,
    unused INTEGER NOT NULL
);
CREATE VIEW reading AS
SELECT poll.id + value.key AS id,
       strftime('%Y-%m-%dT%H:%M:%fZ', poll.time, 'unixepoch') AS time,
       device.name AS device,
       point.name AS name,
       value.value AS value,
       point.unit AS unit,
       coalesce(json_extract(poll.trouble, '$."' || value.key || '"[0]'), 'good') AS quality,
       coalesce(json_extract(poll.trouble, '$."' || value.key || '"[1]'), '') AS reason,
       device.labels AS labels,
       poll.time AS seconds
  FROM device
  JOIN poll ON poll.device = device.id
  JOIN json_each(poll.data) AS value
  JOIN point ON point.id = poll.points
       + coalesce(json_extract(poll.chosen, '$[' || value.key || ']'), value.key);
"""

INSERT_POLL = "INSERT OR IGNORE INTO poll VALUES (?, ?, ?, ?, ?, ?, ?, ?)"

SET_PLACE = (
    "INSERT INTO place VALUES (?, ?) ON CONFLICT DO UPDATE"
    " SET confirmed = max(confirmed, excluded.confirmed)"
)


class Begun(NamedTuple):
    """
    The state of a journal when a run begins.

    Attributes:
        first: the id of the first reading of the run.
        runs: as `Unused` takes them, with this run.
        places: output -> the last id that it confirmed, for all outputs of this run.
    """

    first: int
    runs: list[tuple[int, int]]
    places: dict[str, int]


class JournalState(NamedTuple):
    """
    The state of a journal after a transaction.

    Attributes:
        size: bytes of the file.
        deleted: the last id that was deleted; 0 if none was.
        is_over: False if there is more to delete.
    """

    size: int
    deleted: int
    is_over: bool


class JournalFile:
    """
    The file of a journal, while it is open.

    Args:
        path: its path.
        keep: seconds after which readings are deleted that all outputs confirmed.
        size: the most bytes; the oldest readings are deleted beyond, confirmed or not.
    """

    def __init__(self, path: str, keep: float, size: int) -> None:
        self.path: str = path
        self._keep = keep
        self._size = size
        self._lock = -1
        self._was_used = False
        self._database: sqlite3.Connection | None = None
        # Device -> its labels and points in the last poll.
        self._points: dict[str, tuple[Mapping[str, str], Points]] = {}
        self._to_delete = 0.0
        self._identity: list[Identity] = []

    # --- life -------------------------------------------------------------------------------

    def open(self, outputs: Mapping[str, int] | Collection[str], first: int = 0) -> Begun:
        """
        Open the file, or create it, and begin a run.

        Args:
            outputs: the names of the outputs of the run, or their places.
            first: the next id; 0 for one that the file and the clock give.

        Raises:
            JournalError: this file cannot be used; another program uses it, for example.
            JournalDamaged: the file is not a database, or a damaged one.
        """
        try:
            self._take_lock()
            with raised(self.path):
                self._database = self._connected()
                begun = self._begin(outputs, first)
                self._identity = [_identity_of(f"{self.path}{each}") for each in WITH_IDENTITY]
                return begun
        except JournalDamaged as error:
            was_journal = self._was_used
            self.close()
            if not was_journal:
                raise JournalError(f"{self.path}: is not a journal") from error
            raise
        except BaseException:
            self.close()
            raise

    def _take_lock(self) -> None:
        path = f"{self.path}-lock"
        try:
            if self._lock >= 0 and not _is_at(path, self._lock):
                # Another program may have the lock of this name by now.
                os.close(self._lock)
                self._lock = -1
            if self._lock < 0:
                # Some other file must not be taken for a damaged journal.
                self._was_used = os.path.exists(path)
            if self._lock < 0:
                self._lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            lock_file(self._lock)
        except BlockingIOError:
            raise JournalError(f"{self.path}: is used by another program") from None
        except OSError as error:
            raise JournalError(f"{path}: {error.strerror}") from None

    def _connected(self) -> sqlite3.Connection:
        database = sqlite3.connect(self.path, isolation_level=None, check_same_thread=False)
        try:
            self._prepare(database)
        except BaseException:
            database.close()
            raise
        return database

    def _prepare(self, database: sqlite3.Connection) -> None:
        def pragma(text: str) -> int | str | None:
            row = database.execute(f"PRAGMA {text}").fetchone()
            return row[0] if row else None

        pragma(f"busy_timeout = {BUSY}")
        [tables] = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
        kind, version = pragma("application_id"), pragma("user_version")
        if not tables:
            pragma("auto_vacuum = INCREMENTAL")
        elif kind != APPLICATION:
            raise JournalError(f"{self.path}: is a database of another program")
        elif version != VERSION:
            raise JournalError(
                f"{self.path}: is a journal of version {version}, and this program knows version"
                f" {VERSION} only; name another file"
            )
        if pragma("journal_mode = WAL") != "wal":
            raise JournalError(f"{self.path}: its file system is not suitable for a journal")
        # `force` does both, in another thread: outputs wait for no disk.
        pragma("synchronous = NORMAL")
        pragma("wal_autocheckpoint = 0")
        pragma(f"journal_size_limit = {1 << 26}")
        if not tables:
            # IMMEDIATE, else the tables are created one by one.
            database.executescript(
                f"BEGIN IMMEDIATE; PRAGMA application_id = {APPLICATION};"
                f" PRAGMA user_version = {VERSION}; {SCHEMA} COMMIT"
            )

    def _begin(self, outputs: Mapping[str, int] | Collection[str], first: int) -> Begun:
        database = self._used
        with self._transaction():
            [[last]] = database.execute("SELECT max(id + readings - 1) FROM poll")
            [[begun]] = database.execute("SELECT max(first) FROM run")
            known = max(last or 0, (begun or 1) - 1)
            first = first or first_id(time.time(), known)
            database.execute(
                "INSERT OR REPLACE INTO run VALUES (?, ?)",
                (first, first - 1 - known if known else 0),
            )
            # A new output begins with the next reading.
            database.executemany(
                "INSERT INTO place VALUES (?, ?) ON CONFLICT DO NOTHING",
                outputs.items()
                if isinstance(outputs, Mapping)
                else [(name, first - 1) for name in outputs],
            )
            _forget_runs(database)
            _forget_devices(database)
            runs = database.execute("SELECT first, unused FROM run ORDER BY first").fetchall()
            places = dict(database.execute("SELECT output, confirmed FROM place"))
        return Begun(first, runs, {name: places[name] for name in outputs})

    def close(self) -> None:
        """Force all data onto the disk, close the file, and let others open it."""
        database, self._database = self._database, None
        self._forget()
        if database is not None:
            with contextlib.suppress(sqlite3.Error):
                database.execute("PRAGMA synchronous = FULL")
                database.close()
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1

    def set_aside(self) -> str:
        """
        Close a damaged file and give it another name, which is returned; empty if it is gone.

        Raises:
            JournalTrouble: it cannot be renamed.
        """
        database, self._database = self._database, None
        self._forget()
        if database is not None:
            with contextlib.suppress(sqlite3.Error):
                database.close()
        with raised(self.path):
            self._take_lock()
            if self._identity and not self._is_own(0) and self._is_own(1):
                # Changes of a file that is gone would be merged into the one in its place.
                os.unlink(f"{self.path}-wal")
            moved = _free_name(f"{self.path}-damaged")
            for ending in ("", "-wal", "-shm"):
                with contextlib.suppress(FileNotFoundError):
                    os.rename(f"{self.path}{ending}", f"{moved}{ending}")
            return moved if os.path.exists(moved) else ""

    @property
    def _used(self) -> sqlite3.Connection:
        if self._database is None:
            raise JournalError(f"{self.path}: is not open")
        return self._database

    def _forget(self) -> None:
        """Forget what a transaction that failed may have changed."""
        self._points = {}

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        database = self._used
        database.execute("BEGIN IMMEDIATE")
        try:
            yield
            database.execute("COMMIT")
        except BaseException:
            self._forget()
            with contextlib.suppress(sqlite3.Error):
                if database.in_transaction:
                    database.execute("ROLLBACK")
            raise

    # --- writing ----------------------------------------------------------------------------

    def write(
        self,
        polls: Sequence[JournalPoll],
        places: Mapping[str, int],
        confirmed: int,
    ) -> JournalState:
        """
        Write polls and the places of outputs in one transaction, and delete what is too old.

        Args:
            polls: in the order of their ids.
            places: output -> the last id that it confirmed.
            confirmed: the last id that all outputs confirmed.

        Raises:
            JournalTrouble: nothing was written; it may be possible later.
            JournalDamaged: nothing was written; the file is damaged, or another program has
                deleted or replaced it.
        """
        with raised(self.path):
            self._check_identity()
            with self._transaction():
                rows = [row for poll in polls if (row := self._row(poll)) is not None]
                self._used.executemany(INSERT_POLL, rows)
                self._used.executemany(SET_PLACE, places.items())
            self._to_delete = min(1e6, self._to_delete + DELETED_FOR_EACH * len(rows))
            return self._delete(confirmed)

    def _check_identity(self) -> None:
        """Raise JournalDamaged if what is written would not be found under the file's name."""
        if not (self._is_own(0) and self._is_own(1)):
            raise JournalDamaged(f"{self.path}: was deleted or replaced while it was in use")

    def _is_own(self, at: int) -> bool:
        """Return True if a file still is the one that was opened."""
        try:
            return _identity_of(f"{self.path}{WITH_IDENTITY[at]}") == self._identity[at]
        except FileNotFoundError:
            return False

    def _row(self, poll: JournalPoll) -> Row | None:
        name, labels = poll.readings[0].device, poll.readings[0].labels
        known = self._points.get(name)
        try:
            if known is not None and known[0] == labels:
                with contextlib.suppress(KeyError):
                    return encoded(poll, known[1])
            points = self._points_of(name, labels, poll)
            self._points[name] = labels, points
            return encoded(poll, points)
        except (TypeError, ValueError, RecursionError) as error:
            logger.error("%s: a poll of %s is not written: %s", self.path, name, error)
            return None

    def _device(self, name: str, labels: Mapping[str, str]) -> int:
        row = _stored(name), SORTED_JSON.encode(dict(labels))
        self._used.execute("INSERT OR IGNORE INTO device (name, labels) VALUES (?, ?)", row)
        [[found]] = self._used.execute("SELECT id FROM device WHERE (name, labels) = (?, ?)", row)
        return int(found)

    def _points_of(self, name: str, labels: Mapping[str, str], poll: JournalPoll) -> Points:
        """Return the list of the points of a poll, which is added if the device has none such."""
        device = self._device(name, labels)
        wanted = [(each.name, each.unit) for each in poll.readings]
        stored = [(_stored(name), _stored(unit)) for name, unit in wanted]
        known: dict[int, list[tuple[str, str]]] = {}
        for points, point, unit in self._used.execute(
            "SELECT points, name, unit FROM point WHERE device = ? ORDER BY points, id", (device,)
        ):
            known.setdefault(points, []).append((point, unit))
        number = next((points for points, each in known.items() if each == stored), None)
        if number is None:
            [[last]] = self._used.execute("SELECT max(id) FROM point")
            number = (last or 0) + 1
            self._used.executemany(
                "INSERT INTO point VALUES (?, ?, ?, ?, ?)",
                [(number + at, number, device, *each) for at, each in enumerate(stored)],
            )
        names, units = zip(*wanted, strict=True)
        return Points(number, device, names, units)

    # --- deleting ---------------------------------------------------------------------------

    def _delete(self, confirmed: int) -> JournalState:
        """Delete the oldest polls, if there are too many or they are too old."""
        [[page], [pages], [free]] = (
            self._used.execute(f"PRAGMA {name}").fetchone()
            for name in ("page_size", "page_count", "freelist_count")
        )
        excess = (pages - free) * page - self._size
        if excess > 0:
            most = MOST_DELETED if excess > self._size / 20 else MOST_DELETED // 10
            deleted = self._delete_up_to(self._oldest(most))
        else:
            deleted = self._delete_up_to(self._old(confirmed))
        if pages * page > self._size:
            # As a script, because `execute` ends after the first page.
            self._used.executescript(f"PRAGMA incremental_vacuum({FREED})")
        wal = _size_of(f"{self.path}-wal")
        if wal > max(self._size / 2, LARGEST_WAL):
            raise OSError(errno.EBUSY, "another program has been reading it for too long")
        return JournalState(pages * page + wal, deleted, not deleted)

    def _oldest(self, most: int, last: int = 1 << 62) -> list[tuple[int, int, float]]:
        return self._used.execute(
            "SELECT id, readings, time FROM poll WHERE id <= ? ORDER BY id LIMIT ?", (last, most)
        ).fetchall()

    def _old(self, confirmed: int) -> list[tuple[int, int, float]]:
        """Return the oldest polls that are old enough to be deleted."""
        horizon = time.time() - self._keep
        oldest = self._oldest(int(min(MOST_DELETED, self._to_delete)), confirmed)
        return list(takewhile(lambda each: each[2] < horizon, oldest))

    def _delete_up_to(self, polls: Sequence[tuple[int, int, float]]) -> int:
        """Delete polls, which are the oldest, and return the last id; 0 if there are none."""
        if not polls:
            return 0
        number, count, _ = polls[-1]
        with self._transaction():
            self._used.execute("DELETE FROM poll WHERE id <= ?", (number,))
        self._to_delete = max(0.0, self._to_delete - len(polls))
        return number + count - 1


def _forget_runs(database: sqlite3.Connection) -> None:
    """Forget the runs that all readings and all outputs have left behind."""
    [[poll, place]] = database.execute(
        "SELECT (SELECT min(id) FROM poll), (SELECT min(confirmed) + 1 FROM place)"
    )
    oldest = min(each for each in (poll, place, 1 << 62) if each is not None)
    database.execute(
        "DELETE FROM run WHERE first < (SELECT max(first) FROM run WHERE first <= ?)", (oldest,)
    )


def _forget_devices(database: sqlite3.Connection) -> None:
    """Forget devices all of whose readings were deleted, and their points."""
    unused = (
        "SELECT id FROM device WHERE NOT EXISTS (SELECT 1 FROM poll WHERE poll.device = device.id)"
    )
    for (device,) in database.execute(unused).fetchall():
        database.execute("DELETE FROM point WHERE device = ?", (device,))
        database.execute("DELETE FROM device WHERE id = ?", (device,))


def _stored(text: str) -> str:
    """Return a text that a database can contain."""
    return text.encode("utf-8", "backslashreplace").decode()


def _size_of(path: str) -> int:
    with contextlib.suppress(FileNotFoundError):
        return os.path.getsize(path)
    return 0


def _identity_of(path: str) -> Identity:
    found = os.stat(path)
    return found.st_dev, found.st_ino


def _is_at(path: str, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _free_name(path: str) -> str:
    """Return a path that no file has."""
    names = (path, *(f"{path}-{number}" for number in range(2, 1000)))
    return next((name for name in names if not os.path.exists(name)), path)


def force(path: str) -> None:
    """
    Force what was written to a journal onto the disk, while it is being written.

    Raises:
        JournalError: the disk reports an error.
    """
    wal = f"{path}-wal"
    with raised(path):
        with contextlib.suppress(FileNotFoundError):
            descriptor = os.open(wal, os.O_RDONLY | os.O_CLOEXEC)
            try:
                os.fsync(descriptor)
            finally:
                os.close(descriptor)
        if _size_of(wal) > MERGED:
            with contextlib.closing(sqlite3.connect(path, isolation_level=None)) as database:
                database.execute(f"PRAGMA busy_timeout = {BUSY}")
                database.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchall()
