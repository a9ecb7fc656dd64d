"""
The names of files that were renamed within the same second, and which of them are the oldest.
"""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from libmodbus_py.services.fleet.outputs.rotation import Rotation

# 2026-07-01T12:00:00Z.
TIME = 1_782_907_200


def renamed(path: Path, text: str, keep: int | None = None, time: int = TIME) -> None:
    path.write_text(text)
    os.utime(path, (time, time))
    Rotation("1 MB", keep).rename(str(path), path.stat())


def found(path: Path) -> dict[str, str]:
    return {each.name: each.read_text() for each in path.parent.iterdir()}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "readings.csv"


def test_a_file_is_named_by_its_time_and_a_number_from_the_second_on(path: Path) -> None:
    for text in ("one", "two", "three"):
        renamed(path, text)
    renamed(path, "later", time=TIME + 1)
    assert found(path) == {
        "readings.csv.20260701T120000Z": "one",
        "readings.csv.20260701T120000Z-2": "two",
        "readings.csv.20260701T120000Z-3": "three",
        "readings.csv.20260701T120001Z": "later",
    }


def test_of_one_second_the_greatest_number_is_the_newest(path: Path) -> None:
    for number in range(12):
        renamed(path, str(number))
    renamed(path, "12", keep=4)
    assert sorted(found(path).values()) == ["10", "11", "12", "9"]


def test_the_first_of_a_second_is_older_than_the_second(path: Path) -> None:
    renamed(path, "one")
    renamed(path, "two", keep=1)
    assert found(path) == {"readings.csv.20260701T120000Z-2": "two"}


def test_a_later_second_is_newer_whatever_its_number(path: Path) -> None:
    for number in range(3):
        renamed(path, str(number))
    renamed(path, "later", keep=2, time=TIME + 1)
    assert sorted(found(path).values()) == ["2", "later"]


def test_a_file_that_another_program_has_renamed_leaves_no_empty_one(path: Path) -> None:
    path.write_text("one")
    state = path.stat()
    path.unlink()
    Rotation("1 MB", None).rename(str(path), state)
    assert found(path) == {}
