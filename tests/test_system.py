"""Calls of Linux, and the pipe that takes the place of an eventfd in a Python without it."""

import os
import select
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.system import (
    Flag,
    lock_file,
)

# --- flags --------------------------------------------------------------------------------------


@pytest.fixture(params=["eventfd", "pipe"])
def flag(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Flag]:
    if request.param == "pipe":
        monkeypatch.delattr(os, "eventfd")
    made = Flag()
    yield made
    made.close()


def is_set(flag: Flag) -> bool:
    return bool(select.select([flag.descriptor], [], [], 0)[0])


def test_a_flag_is_readable_from_set_to_clear(flag: Flag) -> None:
    assert not is_set(flag)
    flag.clear()
    flag.set()
    assert is_set(flag)
    flag.set()
    flag.clear()
    assert not is_set(flag)


def test_a_flag_may_be_set_more_often_than_a_pipe_has_room(flag: Flag) -> None:
    for _ in range(70_000):
        flag.set()
    flag.clear()
    assert not is_set(flag)


def test_a_closed_flag_does_nothing_and_leaves_no_descriptor(flag: Flag) -> None:
    before = set(os.listdir("/proc/self/fd"))
    other = Flag()
    other.set()
    for _ in range(2):
        other.close()
        other.set()
        other.clear()
    assert other.descriptor == -1
    assert set(os.listdir("/proc/self/fd")) == before


def test_programs_that_are_started_do_not_inherit_a_flag(flag: Flag) -> None:
    assert not os.get_inheritable(flag.descriptor)


# --- locks --------------------------------------------------------------------------------------


def test_a_file_is_locked(tmp_path: Path) -> None:
    with open(tmp_path / "file", "w") as first, open(tmp_path / "file", "w") as second:
        lock_file(first.fileno())
        with pytest.raises(BlockingIOError):
            lock_file(second.fileno())
