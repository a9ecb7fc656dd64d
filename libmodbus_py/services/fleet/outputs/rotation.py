"""
The rules by which a file of readings is renamed, so that a new one begins, and old ones deleted.
"""

from __future__ import annotations

import contextlib
import os
import re
from datetime import UTC, datetime
from itertools import count

from ....protocol.checks import integer
from ....protocol.mistakes import WrongValue
from ....tools.files.amounts import in_bytes

__all__ = ["Rotation"]

DAILY = "daily"

SMALLEST, LARGEST = "1 kB", "1 TB"

MOST_KEPT = 100_000


class Rotation:
    """
    Renames a file that is too large, or was last written to on an earlier day.

    The name of the old file is the name of the file and the time at which it was last written
    to, such as ``readings.csv.20260131T235959Z``; ``-2`` and so on follow if there is such a file.

    Args:
        rotate: "daily" (at midnight, UTC), or a size from "1 kB" to "1 TB", such as "100 MB",
            which the file does not exceed; None for never. A single batch that is larger is
            written whole.
        keep: how many old files are kept, 0..100000; None for all. Other files are never deleted.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    def __init__(self, rotate: str | None = None, keep: int | None = None) -> None:
        self._is_daily = rotate == DAILY
        self._most = None if rotate is None or self._is_daily else _size(rotate)
        self._keep = None if keep is None else integer("keep", keep, 0, MOST_KEPT)

    @property
    def is_on(self) -> bool:
        """True if files are ever renamed."""
        return self._is_daily or self._most is not None

    def is_due(self, state: os.stat_result, more: int, now: float) -> bool:
        """
        Return True if the file is to be renamed before more is written to it.

        Args:
            state: of the open file, which contains readings.
            more: the bytes that are to be written.
            now: seconds since the epoch.
        """
        if self._most is not None:
            return state.st_size + more > self._most
        # A clock that was set back does not begin a file.
        return self._is_daily and _day(now) > _day(state.st_mtime)

    def rename(self, path: str, state: os.stat_result) -> None:
        """
        Rename the file, and delete the oldest files beyond `keep`.

        Raises:
            OSError: the file cannot be renamed.
        """
        name = _reserved(path, state.st_mtime)
        try:
            os.replace(path, name)
        except OSError as error:
            os.unlink(name)
            if not isinstance(error, FileNotFoundError):  # another program has renamed it
                raise
        if self._keep is not None:
            self._delete(path, self._keep)

    def _delete(self, path: str, keep: int) -> None:
        folder, name = os.path.split(os.path.abspath(path))
        form = re.compile(re.escape(name) + r"\.([0-9]{8}T[0-9]{6}Z)(?:-([0-9]{1,9}))?")
        found = [each for each in map(form.fullmatch, os.listdir(folder)) if each]
        found.sort(key=lambda each: (each[1], int(each[2] or 1)), reverse=True)
        for each in found[keep:]:
            with contextlib.suppress(OSError):  # it is tried again with the next one
                os.unlink(os.path.join(folder, each[0]))


def _size(rotate: object) -> int:
    try:
        return in_bytes("rotate", rotate, SMALLEST, LARGEST)
    except ValueError:
        allowed = f'must be "{DAILY}" or a size in "{SMALLEST}".."{LARGEST}"'
        raise WrongValue("rotate", f"{allowed}, not {rotate!r}") from None


def _day(time: float) -> int:
    return int(time // 86_400)


def _reserved(path: str, time: float) -> str:
    """Return the name of a new, empty file, so that no other program takes the same name."""
    stamp = datetime.fromtimestamp(time, UTC).strftime("%Y%m%dT%H%M%SZ")
    for number in count(1):
        name = f"{path}.{stamp}" + (f"-{number}" if number > 1 else "")
        with contextlib.suppress(FileExistsError):
            os.close(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666))
            return name
    raise AssertionError
