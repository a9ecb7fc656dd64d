"""Calls of Linux, and names that are imported when they are first used."""

import importlib
import os
import select
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.system import Flag, lock_file
from tests.support.cases import each_case


@pytest.fixture(params=["eventfd", "pipe"])
def flag(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[Flag]:
    if request.param == "pipe":
        monkeypatch.delattr(os, "eventfd")
    flag = Flag()
    yield flag
    flag.close()


def test_a_flag_is_readable_while_set_and_closed_once(flag: Flag) -> None:
    for count in (1, 70_000):  # more than a pipe has room
        for _ in range(count):
            flag.set()
        assert select.select([flag.descriptor], [], [], 0)[0]
        flag.clear()
        assert not select.select([flag.descriptor], [], [], 0)[0]
    for _ in range(2):
        flag.close()
        flag.set()
        flag.clear()
    assert flag.descriptor == -1


def test_child_programs_do_not_inherit_a_flag(flag: Flag) -> None:
    assert not os.get_inheritable(flag.descriptor)


def test_a_locked_file_cannot_be_locked_again(tmp_path: Path) -> None:
    with open(tmp_path / "file", "w") as first, open(tmp_path / "file", "w") as second:
        lock_file(first.fileno())
        with pytest.raises(BlockingIOError):
            lock_file(second.fileno())


PACKAGE = "late_names"


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A package with the public name `thing`, whose home is `home.py`."""
    folder = tmp_path / PACKAGE
    folder.mkdir()
    (folder / "__init__.py").write_text(
        "from libmodbus_py.late import Public\n__getattr__ = Public(__name__, __file__).named\n"
    )
    (folder / "__init__.pyi").write_text("from .home import thing as thing\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield folder
    _forget()


def _forget() -> None:
    importlib.invalidate_caches()
    for name in [name for name in sys.modules if name.startswith(PACKAGE)]:
        del sys.modules[name]


@each_case(
    ("way", "home", "reason"),
    [
        (way, home, reason)
        for way in (f"from {PACKAGE} import thing", f"import {PACKAGE} as p; p.thing")
        for home, reason in (
            ("import os\nos.absent\n", "module 'os' has no attribute 'absent'"),
            ("another = 1\n", f"module '{PACKAGE}.home' has no attribute 'thing'"),
        )
    ],
)
def test_the_reason_is_shown_when_the_module_of_a_name_fails(package: Path, way, home, reason):
    (package / "home.py").write_text(home)
    _forget()
    with pytest.raises(ImportError, match=rf"^cannot import {PACKAGE}\.home: {reason}$") as caught:
        exec(way, {})
    assert isinstance(caught.value.__cause__, AttributeError)


def test_other_errors_of_a_lazy_module_are_raised_unchanged(package: Path) -> None:
    (package / "home.py").write_text("raise ValueError('on purpose')\n")
    with pytest.raises(ValueError, match="on purpose"):
        exec(f"from {PACKAGE} import thing", {})


def test_a_name_that_is_not_public_is_an_attribute_error(package: Path) -> None:
    (package / "home.py").write_text("thing = 1\n")
    assert not hasattr(importlib.import_module(PACKAGE), "nothing")
