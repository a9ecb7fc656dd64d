"""The tables of requirements: whole, and what is met is shown by a test."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "security.md").read_text()

# The component requirements of IEC 62443-4-2 that have a level 1 or 2, and concern software.
REQUIREMENTS = {
    1: (1, 2, 3, 4, 5, 7, 8, 9, 10, 11, 12, 14),
    2: (1, 2, 5, 6, 8, 9, 10, 11, 12),
    3: (1, 3, 4, 5, 6, 7, 8, 9),
    4: (1, 2, 3),
    5: (1,),
    6: (1, 2),
    7: (1, 2, 3, 4, 6, 7, 8),
}
ROWS = [
    [cell.strip() for cell in line.strip("|").split("|")]
    for line in PAGE.splitlines()
    if line.startswith("| CR ")
]


def test_each_component_requirement_stands_once() -> None:
    numbers = [match for row in ROWS for match in re.findall(r"CR (\d+\.\d+)", row[0])]
    requirements = [f"{group}.{number}" for group, all in REQUIREMENTS.items() for number in all]
    assert sorted(numbers) == sorted(requirements)


def test_what_is_met_names_a_test() -> None:
    assert {row[1] for row in ROWS} == {"met", "partly", "users", "not met"}
    for requirement, state, how in ROWS:
        tests = re.findall(r"`(tests/[\w/]+\.py)`", how)
        assert bool(tests) == (state == "met"), requirement
        for name in tests:
            assert "def test_" in (ROOT / name).read_text(), name
