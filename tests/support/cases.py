"""
A table of cases in one test: every case is tried, and the failure lists each case that failed.

    for check, (text, value) in each(TABLE):
        with check:
            assert parse(text) == value

A case costs about a microsecond here. A parametrized test costs a millisecond for each case, and
pytest's own `subtests` as much once the report of each case travels from a worker of pytest-xdist.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from types import TracebackType
from typing import TypeVar

import pytest

__all__ = ["Check", "each"]

T = TypeVar("T")

# Of the failed cases, this many are listed with their message.
LISTED = 20


class Check:
    """The context of one case: an assertion or exception inside is noted, and the loop goes on."""

    __slots__ = ("error", "ran")

    def __init__(self) -> None:
        self.ran = False
        self.error: BaseException | None = None

    def __enter__(self) -> None:
        self.ran = True

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> bool:
        if error is None:
            return False
        if not isinstance(error, (Exception, pytest.fail.Exception)) or _is_timeout(error):
            return False
        self.error = error
        return True


def each(
    table: Iterable[T], name: Callable[[T], object] = repr
) -> Generator[tuple[Check, T], None, None]:
    """
    Yield each case of the table with its check; after the last one, raise one AssertionError that
    names the cases that failed. An empty table fails, and so does a case whose check is not used.

    The loop must run to its end: leave it with neither `break` nor `return`.
    """
    failed: list[tuple[str, BaseException]] = []
    count = 0
    try:
        for case in table:
            count += 1
            check = Check()
            yield check, case
            if not check.ran:
                raise AssertionError(f"the check of this case was not used: {name(case)}")
            if check.error is not None:
                failed.append((str(name(case)), check.error))
    except GeneratorExit:
        # Raised while the generator is closed, which pytest reports as a failure of its own.
        if failed or (check.ran and check.error is not None):
            raise AssertionError("the loop was left, and a case had failed") from None
        raise
    if not count:
        raise AssertionError("the table of cases is empty")
    if failed:
        raise AssertionError(_listed(failed, count)) from failed[0][1]


def _is_timeout(error: BaseException) -> bool:
    """pytest-timeout fails the whole test, and rings once only."""
    return isinstance(error, pytest.fail.Exception) and "pytest-timeout" in str(error)


def _listed(failed: list[tuple[str, BaseException]], count: int) -> str:
    lines = [f"{len(failed)} of {count} cases failed:"]
    for name, error in failed[:LISTED]:
        text = f"{type(error).__name__}: {error}".replace("\n", "\n      ")
        lines += [f"  {name}", f"    {_place(error)}: {text}"]
    lines += [f"  {name}" for name, _ in failed[LISTED:]]
    return "\n".join(lines)


def _place(error: BaseException) -> str:
    """Return the file and line of the test's own code that raised."""
    place = error.__traceback__
    return f"{Path(place.tb_frame.f_code.co_filename).name}:{place.tb_lineno}" if place else "?"
