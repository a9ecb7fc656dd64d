"""
Names as levels of topics and subjects: there and back, and nothing else back.
"""

from __future__ import annotations

from libmodbus_py.services.fleet.outputs.topics import Levels
from tests.support.cases import each_case

LEVELS = Levels(r"[\s.%/]")

NAMES = ["north", "hall.2", "a b", "50%", "%2E", "kälte", "日本", "/", "x" * 100]


def test_a_name_is_read_from_its_level() -> None:
    assert [LEVELS.read(LEVELS.spell(name)) for name in NAMES] == NAMES
    assert LEVELS.spell("hall.2 50%/kälte") == "hall%2E2%2050%25%2Fkälte"
    assert len({LEVELS.spell(name) for name in NAMES}) == len(NAMES)


SPELT_OTHERWISE = ["", "n%6Frth", "hall.2", "hall%2e2", "%", "%2", "%zz", "%FF", "%0A", "a\n"]

TOO_LONG = ["x" * 101, "%25" * 101, "a" * 100_000]


@each_case("level", [*SPELT_OTHERWISE, *TOO_LONG])
def test_a_level_in_another_spelling_is_no_name(level: str) -> None:
    assert LEVELS.read(level) is None
