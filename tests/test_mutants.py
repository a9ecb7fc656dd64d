"""The tool that changes the package in single places finds what no test notices."""

from __future__ import annotations

import ast
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.mutants import DECIDING, Running, chosen, judged
from fuzz.mutations import TUNING, mutants

ROOT = Path(__file__).parent.parent

SOURCE = '''\
"""A docstring, 1."""
LIMIT: int = 3


class Tank:
    """Another one."""

    def fill(self, level: int = 2) -> int:
        """Fill it, 4."""
        if level > LIMIT and not self.is_full:
            raise ValueError("more than 5")
        self.level = max(
            level,
            0,
        )
        self.note()
        return self.level + 1

    def __repr__(self) -> str:
        return "Tank" * 6
'''

EXPECTED = [
    (2, "constant", "3 -> 4"),
    (8, "constant", "2 -> 3"),
    (10, "and/or", "level > LIMIT and (not self.is_full) -> level > LIMIT or not self.is_full"),
    (10, "boundary", "level > LIMIT -> level >= LIMIT"),
    (10, "comparison", "level > LIMIT -> level <= LIMIT"),
    (10, "not", "not self.is_full -> bool(self.is_full)"),
    (11, "raise removed", "raise ValueError('more than 5') -> pass"),
    (12, "assignment removed", "self.level = max(level, 0) -> pass"),
    (12, "max", "max(level, 0) -> min(level, 0)"),
    (14, "constant", "0 -> 1"),
    (16, "call removed", "self.note() -> pass"),
    (17, "return value", "return self.level + 1 -> return None"),
    (17, "arithmetic", "self.level + 1 -> (self.level - 1)"),
    (17, "constant", "1 -> 2"),
]


@pytest.fixture
def tank(tmp_path: Path) -> Path:
    path = tmp_path / "tank.py"
    path.write_text(SOURCE)
    return path


def test_each_place_is_changed_and_texts_are_not(tank: Path) -> None:
    places = [
        (mutant.line, mutant.operator, str(mutant).partition(f"{mutant.operator}: ")[2])
        for mutant in mutants(tank)
    ]
    assert sorted(places) == sorted(EXPECTED)


def test_values_of_tuning_constants_are_left_alone_and_their_uses_are_not(tmp_path: Path) -> None:
    path = tmp_path / "pump.py"
    path.write_text(
        """
MOST_AT_ONCE = 1 << 8
FIRST_PAUSE, HIGHEST = 0.5, 30.0
shown = field(repr=False); pairs = zip(a, b, strict=True); warn("old", stacklevel=2)
if TYPE_CHECKING:
    from pump import Pump


def take(waiting: list[int]) -> bool:
    logger.info("%d wait", len(waiting))
    return len(waiting) < MOST_AT_ONCE
"""
    )
    places = {(mutant.line, mutant.operator) for mutant in mutants(path)}
    assert places == {
        (3, "assignment removed"),
        (3, "constant"),
        # No boundary: that is a value which is larger by one.
        (11, "comparison"),
        (11, "return value"),
    }


def test_each_tuning_constant_is_one_of_the_package() -> None:
    defined = {
        name.id
        for path in (ROOT / "libmodbus_py").rglob("*.py")
        for node in ast.parse(path.read_text()).body
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for name in ast.walk(node)
        if isinstance(name, ast.Name)
    }
    assert frozenset().union(*TUNING.values()) - defined == set()


def test_the_same_seed_draws_the_same() -> None:
    first, again, other = (
        list(map(str, chosen(["services/gateway"], 5, seed))) for seed in (1, 1, 2)
    )
    assert first == again != other
    assert len(first) == 5


def test_mutants_can_be_drawn_from_each_file_that_decides() -> None:
    for place in DECIDING:
        assert chosen([place], 1, seed=1), place


def test_what_keeps_the_package_from_being_imported_is_no_survivor(tmp_path: Path) -> None:
    (tmp_path / "output").write_text("ImportError while loading conftest 'tests/conftest.py'.\n")
    (mutant,) = chosen(["protocol/pdu/serial.py"], 1, seed=1)
    running = Running(mutant, {}, pid=0, until=0.0, folder=tmp_path)
    assert judged(running, pytest.ExitCode.USAGE_ERROR).kind == "broken"
    (tmp_path / "output").write_text("ERROR: file or directory not found: tests/nothing.py\n")
    assert judged(running, pytest.ExitCode.USAGE_ERROR).kind == "unknown"
    assert judged(running, None).kind == judged(running, -signal.SIGXCPU).kind == "hung"


TRYING = """
import sys
from pathlib import Path
from fuzz.covering import Covering
from fuzz.mutants import Trial
from fuzz.mutations import mutants

path = Path("libmodbus_py/services/line.py")
(mutant,) = [each for each in mutants(path) if str(each).endswith("misses - 1 -> (misses + 1)")]
for file in sys.argv[1:]:
    trial = Trial(Covering(), Path("."), 1)
    # A test may take 10 s, and ten times as long as it takes without a mutant: together 1 s.
    trial.tests_of = lambda mutant: {f"{file}::test_it": -0.9}
    print(*(outcome.kind for outcome in trial.run([mutant])))
"""

BODIES = {
    "killed": "assert pause_after(3, 1.0, 60.0) == 4.0",
    "survived": "pause_after(3, 1.0, 60.0)",
    "hung": "pause_after(3, 1.0, 60.0) == 4.0 or threading.Event().wait()",
}


def test_a_mutant_is_killed_by_a_test_that_notices(tmp_path: Path) -> None:
    """In a folder with links to all that it needs, and tests of its own."""
    for folder in ("libmodbus_py", "fuzz"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    for kind, body in BODIES.items():
        head = "import threading\nfrom libmodbus_py.services.line import pause_after\n"
        (tmp_path / f"test_{kind}.py").write_text(f"{head}\n\ndef test_it():\n    {body}\n")
    command = [sys.executable, "-c", TRYING, *(f"test_{kind}.py" for kind in BODIES)]
    process = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=tmp_path)
    assert process.stdout.split() == list(BODIES)
