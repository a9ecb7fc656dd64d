"""
A table of cases in one test: every case is tried, and the failure lists each case that failed.

    @each_case(("text", "value"), TABLE)
    def test_parse(text: str, value: int) -> None:
        assert parse(text) == value

`each_case` takes what `pytest.mark.parametrize` takes, several of them make every combination, and
before a class it stands before each of its tests. A fixture is made once for the whole table: what
a case changes it has to make itself. The same as a loop:

    for check, (text, value) in each(TABLE):
        with check:
            assert parse(text) == value

A case costs about a microsecond here. A parametrized test costs a millisecond for each case, and
pytest's own `subtests` as much once the report of each case travels from a worker of pytest-xdist.
"""

import functools
import inspect
import itertools
import reprlib
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import pytest

T = TypeVar("T")

# Of the failed cases, this many are listed with their message.
LISTED = 20

SHORT = reprlib.Repr()
SHORT.maxstring = SHORT.maxother = 100


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


def each_case(
    names: str | Sequence[str],
    table: Iterable[Any],
    ids: Iterable[object] | Callable[[Any], object] | None = None,
) -> Callable[[T], T]:
    """Return a decorator that calls a test with each case of the table; see the module."""
    arguments = [name.strip() for name in names.split(",")] if isinstance(names, str) else [*names]
    single = isinstance(names, str) and len(arguments) == 1
    rows = _Rows(arguments, [_values(case, single) for case in table], ids)

    def decorated(test: Any) -> Any:
        if not isinstance(test, type):
            return _looping(test, rows)
        for name, function in list(vars(test).items()):
            if name.startswith("test_"):
                setattr(test, name, _looping(function, rows))
        return test

    return decorated


class _Rows:
    """The cases of one decorator: the arguments of each case, and its name."""

    def __init__(
        self,
        names: list[str],
        table: list[Sequence[Any]],
        ids: Iterable[object] | Callable[[Any], object] | None,
    ) -> None:
        self.names = names
        self.cases = [dict(zip(names, values, strict=True)) for values in table]
        self._ids = ids if ids is None or callable(ids) else [*ids]
        if isinstance(self._ids, list) and len(self._ids) != len(self.cases):
            raise ValueError(f"{len(self.cases)} cases have {len(self._ids)} ids")

    def name(self, at: int) -> str:
        if isinstance(self._ids, list):
            return str(self._ids[at])
        show = self._ids or SHORT.repr
        return ", ".join(f"{name}={show(value)}" for name, value in self.cases[at].items())


def _values(case: Any, single: bool) -> Sequence[Any]:
    """Return the values of one row, which may be a `pytest.param` without marks."""
    if isinstance(case, type(pytest.param())):
        if case.marks:
            raise ValueError("a case of a table has no marks of its own")
        return case.values
    return (case,) if single else tuple(case)


def _looping(test: Any, *tables: _Rows) -> Any:
    """Return a test that asks pytest for the fixtures only, and gets the rest from the tables."""
    inner, tables = getattr(test, "_looped", test), (*tables, *getattr(test, "_tables", ()))
    names = {name for rows in tables for name in rows.names}
    signature = inspect.signature(inner)
    if unknown := names - signature.parameters.keys():
        raise ValueError(f"{inner.__qualname__} has no parameter {', '.join(sorted(unknown))}")

    @functools.wraps(inner)
    def looping(*args: Any, **fixtures: Any) -> None:
        places = itertools.product(*(range(len(rows.cases)) for rows in tables))
        for check, at in each(places, lambda at: _name(tables, at)):
            with check:
                values = dict(fixtures)
                for rows, place in zip(tables, at, strict=True):
                    values |= rows.cases[place]
                inner(*args, **values)

    parameters = [value for name, value in signature.parameters.items() if name not in names]
    for name in [name for name in vars(looping) if "hypothesis" in name]:
        delattr(looping, name)  # these belong to the inner test only
    looping.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    looping._looped, looping._tables = inner, tables  # type: ignore[attr-defined]
    return looping


def _name(tables: tuple[_Rows, ...], at: tuple[int, ...]) -> str:
    return ", ".join(rows.name(place) for rows, place in zip(tables, at, strict=True))


def _is_timeout(error: BaseException) -> bool:
    """pytest-timeout fails the whole test, and rings once only."""
    return isinstance(error, pytest.fail.Exception) and "pytest-timeout" in str(error)


def _listed(failed: list[tuple[str, BaseException]], count: int) -> str:
    lines = [f"{len(failed)} of {count} cases failed:"]
    for name, error in failed[:LISTED]:
        text = "\n".join([f"{type(error).__name__}: {error}", *getattr(error, "__notes__", ())])
        lines += [f"  {name}", f"    {_place(error)}: {text}".replace("\n", "\n      ")]
    lines += [f"  {name}" for name, _ in failed[LISTED:]]
    return "\n".join(lines)


def _place(error: BaseException) -> str:
    """Return the file and line of the test's own code that raised."""
    place = error.__traceback__
    while place and place.tb_next and place.tb_frame.f_code.co_filename == __file__:
        place = place.tb_next
    return f"{Path(place.tb_frame.f_code.co_filename).name}:{place.tb_lineno}" if place else "?"
