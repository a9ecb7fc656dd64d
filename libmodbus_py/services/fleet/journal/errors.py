"""
The errors of journals.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator

__all__ = ["JournalDamaged", "JournalError", "JournalTrouble", "raised"]

_DAMAGE = {sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB}

_REASONS: dict[int, str] = {
    sqlite3.SQLITE_FULL: "the disk is full",
    sqlite3.SQLITE_READONLY: "cannot be written to",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened; its folder must exist, and be writable",
    sqlite3.SQLITE_PERM: "must not be opened",
    sqlite3.SQLITE_BUSY: "another program has locked it",
    sqlite3.SQLITE_LOCKED: "another program has locked it",
    sqlite3.SQLITE_IOERR: "the disk reports an error",
}


class JournalError(Exception):
    """A journal cannot be used: it has another version, or another program uses it."""


class JournalDamaged(JournalError):
    """The file of a journal is damaged, or another program has deleted or replaced it."""


class JournalTrouble(JournalError):
    """A journal cannot be used now; a disk is full, for example."""


@contextlib.contextmanager
def raised(path: str) -> Iterator[None]:
    """Raise errors of SQLite and of the system as those of journals."""
    try:
        yield
    except sqlite3.Error as error:
        code = (getattr(error, "sqlite_errorcode", None) or 0) & 0xFF
        if code in _DAMAGE:
            raise JournalDamaged(f"{path}: is damaged: {error}") from error
        raise JournalTrouble(f"{path}: {_REASONS.get(code, str(error))}") from error
    except OSError as error:
        raise JournalTrouble(f"{path}: {error.strerror or error}") from error
