"""
Files that are read again: what is told, and that a mistake changes nothing.
"""

from __future__ import annotations

import pytest

from libmodbus_py.tools.files.texts import compared, reread
from tests.support.cases import each_case


def test_the_content_is_used_and_what_changed_is_returned() -> None:
    used: list[str] = []

    def use(content: str) -> str:
        used.append(content)
        return "all is new"

    assert reread(lambda: "content", use) == "all is new"
    assert used == ["content"]


@pytest.mark.parametrize("kind", [TypeError, ValueError])
def test_a_mistake_is_returned_and_nothing_used(kind: type[Exception]) -> None:
    def load() -> str:
        raise kind("line 4: unit must be in 0..255")

    line = reread(load, lambda content: pytest.fail(content))
    assert line == "the former content is used: line 4: unit must be in 0..255"


def test_content_that_cannot_be_used_is_returned_as_a_mistake() -> None:
    def use(content: str) -> str:
        raise ValueError("two routes for unit 1")

    line = reread(lambda: "content", use)
    assert line == "the former content is used: two routes for unit 1"


def test_other_errors_are_raised() -> None:
    def load() -> str:
        raise RuntimeError("a bug")

    with pytest.raises(RuntimeError, match="a bug"):
        reread(load, lambda content: "")


@each_case(
    ("before", "after", "expected"),
    [
        ({}, {"a": 1}, "1 device: 1 new"),
        ({"a": 1, "b": 2}, {"a": 1, "b": 2}, "2 devices: no change"),
        (
            {"a": 1, "b": 2, "c": 3, "d": 4},
            {"a": 0, "b": 2, "e": 5, "f": 6},
            "4 devices: 2 new, 1 changed, 2 removed",
        ),
    ],
)
def test_what_changed_is_counted(
    before: dict[str, int], after: dict[str, int], expected: str
) -> None:
    assert compared("a.toml", "device", before, after) == f"a.toml: read again, {expected}"
