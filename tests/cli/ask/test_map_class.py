"""
The command map class: the file that it writes, and the files that it does not overwrite.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from tests.support.cases import each_case
from tests.support.commands import run

MAP = "name,table,address,type,access\nvoltage,input,0,uint16,read\nset point,holding,1,,\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "meter.csv").write_text(MAP)
    return tmp_path


def test_it_writes_and_prints_the_same(folder: Path) -> None:
    printed = run("map", "class", folder / "meter.csv")
    assert (printed.code, printed.err) == (0, "")
    assert "class Meter(" in printed.out
    assert "def set_point(self) -> int:" in printed.out
    for _ in range(2):  # it takes the place of what the command itself has written
        done = run("map", "class", folder / "meter.csv", "-o", folder / "plant.py")
        assert (done.code, done.out, done.err) == (0, "", f"{folder / 'plant.py'}: 2 points\n")
        assert (folder / "plant.py").read_text() == printed.out
    assert sorted(os.listdir(folder)) == ["meter.csv", "plant.py"]


@each_case(
    ("output", "message"),
    [
        ("mine.py", "mine.py exists, and would be overwritten"),
        ("meter.txt", "meter.txt: it must end with .py"),
        ("none/meter.py", "none/meter.py: the folder does not exist"),
    ],
)
def test_other_files_are_not_overwritten(output: str, message: str, folder: Path) -> None:
    (folder / "mine.py").write_text("x = 1\n")
    done = run("map", "class", folder / "meter.csv", "-o", folder / output)
    assert done.code == 2
    assert message in done.err
    assert (folder / "mine.py").read_text() == "x = 1\n"


def test_a_wrong_map_is_told_with_its_line(folder: Path) -> None:
    (folder / "meter.csv").write_text(MAP.replace("uint16", "unit16"))
    done = run("map", "class", folder / "meter.csv", "-o", folder / "meter.py")
    assert done.code == 2
    assert "meter.csv, line 2, column type" in done.err
    assert not (folder / "meter.py").exists()


def test_the_names_of_files_stay_texts(folder: Path) -> None:
    for name in ('x"""\nimport os #', "a\\", "import", "7-Eleven \u2028 x", "Any", "ä ö"):
        path = folder / f"{name}.csv"
        path.write_text(MAP)
        done = run("map", "class", path)
        assert done.code == 0, done.err
        compile(done.out, "made.py", "exec")


def test_a_new_file_can_be_read_by_others(folder: Path) -> None:
    before = os.umask(0o022)
    try:
        run("map", "class", folder / "meter.csv", "-o", folder / "meter.py")
    finally:
        os.umask(before)
    assert stat.S_IMODE((folder / "meter.py").stat().st_mode) == 0o644


@each_case("action", ["check", "class"])
def test_maps_of_the_package_have_names(action: str) -> None:
    done = run("map", action, "sdm120")
    assert (done.code, done.err) == (0, "")
    assert "points" in done.out
    done = run("map", action, "sdm")
    assert done.code == 2
    assert "'sdm' is neither the path of a register map" in done.err
    assert done.err.count("\n") == 1
