"""Values read from files, and read again: certificates, keys and passwords."""

from __future__ import annotations

import errno
import os
import stat
import weakref
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from ..protocol.logs import HarmlessLogger
from ..protocol.mistakes import Problem
from ..system import open_file

logger: HarmlessLogger = HarmlessLogger(__name__)

T = TypeVar("T")

# The exceptions for a mistake in a file, and for a file that cannot be read.
MISTAKES = (ImportError, OSError, TypeError, ValueError)


def read_secret(path: str | os.PathLike[str]) -> str:
    """Return the text of a file with a secret, up to 64 KiB; others must not be able to read it."""
    with open_file(path) as file:
        mode = os.fstat(file.fileno()).st_mode
        if os.name == "posix" and mode & stat.S_IROTH:
            reason = "all users of this machine can read this secret; chmod o= ends that"
            raise PermissionError(errno.EACCES, reason, os.fspath(path))
        return file.read(1 << 16).decode()  # a file that was named by mistake may have more


class _Reloadable(Protocol):
    def reload(self) -> None: ...


class Renewed(Generic[T]):
    """A value that `read` makes of files, as of the last time that all of them were good."""

    def __init__(self, read: Callable[[], T]) -> None:
        self._read = read
        self._logged = ""
        self.value: T = read()
        keep_renewed(self)

    def reload(self) -> None:
        """Read the files again; raise what `read` raises, and keep the value then."""
        self.value = self._read()

    def fresh(self) -> T:
        """Read the files again and return the value; log a mistake, and return the former value."""
        try:
            self.reload()
            self._logged = ""
        except MISTAKES as error:
            if self._logged != str(error):
                self._logged = str(error)
                logger.warning("the former content is used: %s", error)
        return self.value


_in_use: weakref.WeakSet[_Reloadable] = weakref.WeakSet()


def keep_renewed(reloadable: _Reloadable) -> None:
    """Let `reload_all` reload an object as long as it exists."""
    _in_use.add(reloadable)


def reload_all() -> list[str]:
    """Reload all certificates, keys and passwords, as on SIGHUP; return lines for the log."""
    lines: list[str] = []
    reloadables = list(_in_use)
    for reloadable in reloadables:
        try:
            reloadable.reload()
        except MISTAKES as error:
            lines.append(Problem(f"the former content is used: {error}"))
    return lines or ["certificates and passwords: read again"] * bool(reloadables)
