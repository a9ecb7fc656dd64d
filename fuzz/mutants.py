"""
Change one place of the package at a time, and see whether a test fails.

    ./run python -m fuzz.mutants [FOLDER ...] [--sample N] [--seed S]

Mutants are drawn at random from the files that decide, or from those named: a folder of the
package, a file, or FILE:LINE. For each mutant those tests run that execute the changed line and
stand in the test folder beside, or in the simulated world; those in files with the name of the
module come first, then the fastest, and the first failure ends it. A mutant that no test notices
survives, and is listed.

Why this is not a library: mutmut 3 changes functions only, through copies that tests of signatures
and of pickling see, and draws no samples; cosmic-ray runs one command for all mutants, however few
tests reach the changed line. Here a mutant is a fork of a process that has imported what the tests
need; one module of the package is then loaded from the changed text. No file of the work tree
changes. Programs that tests start are not mutants: what only they execute is not reached.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import importlib
import importlib.abc
import importlib.machinery
import importlib.util
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import pytest

from fuzz.covering import FOLDER, PACKAGE, Covering
from fuzz.mutations import Mutant, mutants

BUILD = Path("build/mutants")

# The files that decide about requests, turns, time and bytes.
DECIDING = [
    *("client", "services/gateway", "services/fleet", "services/workers", "protocol"),
    *(f"server/{name}.py" for name in ("faults", "framed", "limits", "peer", "peers", "sessions")),
    "tools/faults/fault.py",
]

# Where the tests of a folder stand, if not in the folder of the same name; all have the world.
BESIDE = {
    "services/engine": ("services/engine", "services/workers"),
    "binding": ("client", "server"),
    "device": ("device", "server"),
    "protocol": ("protocol", "client", "server"),
    # A gateway is a server, too, and many tests of either try both.
    "services/gateway": ("services/gateway", "server"),
    "server": ("server", "services/gateway", "tools/faults"),
    "tools/faults": ("tools/faults", "server"),
    # Workers are fleets, whose commands and records come over the engine.
    "services/fleet": ("services/fleet", "services/workers"),
}
WORLD = "simulation"

GROUPS = ("services", "tools")
"""Folders of the package whose folders have tests of their own."""

# Imported before the first fork, for they take the time of many tests.
HEAVY = ("asyncio", "cffi", "cryptography.x509", "hypothesis", "ssl", "pytest_timeout", "xdist")

BUDGET = 20.0
"""Seconds of tests for one mutant; survivors alone take all of it."""

BROKEN = 100
"""How a process ends that could not import its mutant."""

_CONFTEST = "ImportError while loading conftest"
"""What pytest says if the package cannot be imported as a whole, though the changed module can."""

LEFT_OUT = "not ctrl_c_at_any_moment"
"""A KeyboardInterrupt within coverage.py leaves its lock taken: the next line waits for ever."""

PATIENCE = 600.0
"""Seconds for the tests of one file, without a mutant."""

MEMORY = 4 << 30
"""Bytes. A mutant that collects for ever ends there, and counts as one that hung."""


class _Loader(importlib.machinery.SourceFileLoader):
    """Loads a module from another text than that of its file."""

    def __init__(self, name: str, path: str, source: str) -> None:
        super().__init__(name, path)
        self._source = source

    def get_code(self, fullname: str) -> CodeType:
        return compile(self._source, self.path, "exec", dont_inherit=True)


class _Finder(importlib.abc.MetaPathFinder):
    """Finds one module, which is changed, before all others do."""

    def __init__(self, path: Path, source: str) -> None:
        parts = path.with_suffix("").parts
        self._is_package = parts[-1] == "__init__"
        self.name = ".".join(parts[:-1] if self._is_package else parts)
        self._path, self._source = str(path.resolve()), source

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.name:
            return None
        return importlib.util.spec_from_file_location(
            fullname,
            self._path,
            loader=_Loader(fullname, self._path, self._source),
            submodule_search_locations=[os.path.dirname(self._path)] if self._is_package else None,
        )


class _Chosen:
    """Has pytest run some of the tests it found, in a given order, each for a limited time."""

    def __init__(self, tests: dict[str, float]) -> None:
        self._tests = tests

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        order = {name: place for place, name in enumerate(self._tests)}
        items[:] = sorted(
            (item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid]
        )
        for item in items:
            item.add_marker(pytest.mark.timeout(_patience(self._tests[item.nodeid])), append=False)


def _patience(seconds: float) -> float:
    return 10 + 10 * seconds


@dataclass
class Outcome:
    """
    What became of a mutant.

    Attributes:
        kind: `killed`, `hung`, `broken` (the package could not be imported), `survived`,
            `unreached`, if no test executes the line, or `unknown`, if no test could run.
        tests: how many were chosen.
        by: the test that failed.
    """

    mutant: Mutant
    kind: str
    tests: int = 0
    by: str = ""

    @property
    def is_killed(self) -> bool:
        return self.kind in ("killed", "hung", "broken")


@dataclass
class Running:
    mutant: Mutant
    tests: dict[str, float]
    pid: int
    until: float
    folder: Path


@dataclass
class Trial:
    """
    Runs the tests of mutants, several mutants at once.

    Attributes:
        covering: known tests; forgotten when those of each mutant are chosen, for it is large,
            and each fork has all of this process.
        folder: for what the tests of a mutant write.
        budget: seconds of tests for one mutant.
    """

    covering: Covering
    folder: Path
    jobs: int
    budget: float = BUDGET
    _running: list[Running] = field(default_factory=list)
    _count: int = 0

    def run(self, chosen: Sequence[Mutant]) -> Iterator[Outcome]:
        """Yield what became of each mutant, in the order in which they end."""
        waiting = [(mutant, self.tests_of(mutant)) for mutant in reversed(chosen)]
        self.covering = Covering()
        gc.collect()
        gc.freeze()
        try:
            while waiting or self._running:
                while waiting and len(self._running) < self.jobs:
                    mutant, tests = waiting.pop()
                    if tests:
                        self._start(mutant, tests)
                    else:
                        yield Outcome(mutant, "unreached")
                yield from self._ended()
                time.sleep(0.02)
        finally:
            for running in self._running:
                _kill(running.pid)

    def tests_of(self, mutant: Mutant) -> dict[str, float]:
        """Return the tests that may notice a mutant, and their seconds; the best come first."""
        seconds = self.covering.seconds
        found = self.covering.of_lines(mutant.path, *mutant.lines)
        near = set(found)
        if not found:
            near = self._using(mutant)
            near |= {test for test in seconds if _is_about(test, mutant.path)}
            found = near | self.covering.of_file(mutant.path)
        folders = tuple(f"tests/{folder}/" for folder in _beside(mutant.path))
        beside = sorted(
            (test for test in found if test.startswith(folders)), key=seconds.__getitem__
        )
        likely = [test for test in beside if test in near]
        likely.sort(key=lambda test: not _is_about(test, mutant.path))
        tests = self._within(likely, self.budget / 2, {})
        return self._within(beside, self.budget, tests)

    def _within(
        self, ordered: Sequence[str], budget: float, tests: dict[str, float]
    ) -> dict[str, float]:
        """Add the first tests for which there is time, at least one, to those already chosen."""
        total = sum(tests.values()) + 0.01 * len(tests)
        for test in ordered:
            if test in tests:
                continue
            total += self.covering.seconds[test] + 0.01
            if total > budget and tests:
                break
            tests[test] = self.covering.seconds[test]
        return tests

    def _using(self, mutant: Mutant) -> set[str]:
        """Return the tests of those lines that name what a statement outside functions defines."""
        if not mutant.names:
            return set()
        found: set[str] = set()
        words = re.compile(rf"\b({'|'.join(mutant.names)})\b")
        for number, line in enumerate(mutant.path.read_text().splitlines(), 1):
            if words.search(line):
                found |= self.covering.of_lines(mutant.path, number, number)
        return found

    def _start(self, mutant: Mutant, tests: dict[str, float]) -> None:
        self._count += 1
        folder = self.folder / str(self._count)
        folder.mkdir()
        limit = 60 + sum(_patience(0) / 10 + 3 * seconds for seconds in tests.values())
        sys.stdout.flush()
        pid = os.fork()
        if pid == 0:
            _become(mutant, tests, folder)
        self._running.append(Running(mutant, tests, pid, time.monotonic() + limit, folder))

    def _ended(self) -> Iterator[Outcome]:
        for running in list(self._running):
            pid, status = os.waitpid(running.pid, os.WNOHANG)
            is_late = not pid and time.monotonic() > running.until
            if not pid and not is_late:
                continue
            self._running.remove(running)
            _kill(running.pid)
            if is_late:
                os.waitpid(running.pid, 0)
            yield judged(running, None if is_late else os.waitstatus_to_exitcode(status))
            shutil.rmtree(running.folder, ignore_errors=True)


def _is_about(test: str, path: Path) -> bool:
    """Return True if a test stands in a file that has the name of a module within its own."""
    return path.stem in test.split("::", 1)[0].rpartition("/")[2]


def _beside(path: Path) -> tuple[str, ...]:
    depth = 3 if path.parts[1] in GROUPS and len(path.parts) > 3 else 2
    name = "/".join(path.parts[1:depth])
    return (*BESIDE.get(name, (name,)), WORLD)


def files_beside(drawn: Sequence[Mutant]) -> list[Path]:
    """Return the test files that stand beside any of these mutants, in folders at any depth."""
    folders = {folder for mutant in drawn for folder in _beside(mutant.path)}
    found = {path for folder in folders for path in Path("tests", folder).rglob("test_*.py")}
    return sorted(found)


def _become(mutant: Mutant, tests: dict[str, float], folder: Path) -> None:
    """Run the tests of a mutant in this process, which is a fork, and end it."""
    code = int(pytest.ExitCode.INTERNAL_ERROR)
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.RLIM_INFINITY))
        # A loop of the simulated world goes on although its test has failed for being late.
        processor = int(60 + sum(3 * seconds + 0.1 for seconds in tests.values()))
        resource.setrlimit(resource.RLIMIT_CPU, (processor, resource.RLIM_INFINITY))
        with open(folder / "output", "w") as output, open(os.devnull) as nothing:
            os.dup2(nothing.fileno(), 0)
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
        os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = str(folder / "hypothesis")
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
        random.seed(0)
        finder = _Finder(mutant.path, mutant.source)
        sys.meta_path.insert(0, finder)
        code = BROKEN
        # Before pytest, whose own finder would take the module from its file.
        importlib.import_module(finder.name)
        code = int(pytest.ExitCode.INTERNAL_ERROR)
        files = list(dict.fromkeys(test.split("::", 1)[0] for test in tests))
        options = ["-x", "-q", "--tb=line", "-p", "no:cacheprovider", "-p", "no:xdist"]
        options += ["-W", "ignore::pytest.PytestAssertRewriteWarning"]
        basetemp = f"--basetemp={folder / 'files'}"
        code = int(pytest.main([*options, basetemp, *files], plugins=[_Chosen(tests)]))
    finally:
        with contextlib.suppress(Exception):
            sys.stdout.flush()
        os._exit(code)


def judged(running: Running, code: int | None) -> Outcome:
    output = (running.folder / "output").read_text(errors="replace")
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
    by = failed[1] if failed else ""
    was_ended = code in (None, -signal.SIGXCPU)
    if was_ended or "Failed: Timeout (" in output or "MemoryError" in output:
        kind = "hung"
    elif code == 0:
        kind = "survived"
    elif code == pytest.ExitCode.NO_TESTS_COLLECTED:
        kind = "unreached"
    elif code == BROKEN or (code == pytest.ExitCode.USAGE_ERROR and _CONFTEST in output):
        kind = "broken"
    elif by or (code or 0) < 0:
        kind = "killed"
    else:
        kind = "unknown"
        _tell(f"the tests could not run:\n{output[-4000:]}")
    return Outcome(running.mutant, kind, len(running.tests), by)


def _kill(pid: int) -> None:
    """End a mutant and what its tests have started."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)


def cover(tests: list[Path], jobs: int) -> Covering:
    """Return which tests execute which lines; test files that changed run for it."""
    if importlib.util.find_spec("coverage") is None:
        raise SystemExit("coverage is not installed: ./run python installs it")
    BUILD.mkdir(parents=True, exist_ok=True)
    covering = Covering.read(BUILD / "covering.json")
    stale = covering.stale(tests)
    if not stale:
        return covering
    _tell(f"running the tests of {len(stale)} files, to see which lines they execute")
    covering.forget(stale)
    with ThreadPoolExecutor(jobs) as pool:
        for path, parts in pool.map(_covered, stale):
            covering.add(parts, path)
            covering.write(BUILD / "covering.json")
    return covering


def _covered(path: Path) -> tuple[Path, list[dict[str, Any]]]:
    """Run the tests of a file in a process of their own, and return what it wrote down."""
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:xdist", "-p", "fuzz.covering"]
        command += ["-p", "no:cacheprovider", "--timeout=60", "-k", LEFT_OUT]
        command.append(str(path))
        environment = {**os.environ, FOLDER: folder, "TMPDIR": folder}
        started = subprocess.Popen(
            command,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        try:
            output, _ = started.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            _kill(started.pid)
            output, _ = started.communicate()
        finally:
            _kill(started.pid)
        if started.returncode:
            _tell(f"{output[-4000:]}\n{path}: what fails there without a mutant is left out")
        return path, [json.loads(part.read_text()) for part in Path(folder).glob("part-*.json")]


def chosen(places: Sequence[str], sample: int, seed: int) -> list[Mutant]:
    """Draw mutants from folders of the package, files, or lines of files."""
    found: list[Mutant] = []
    for place in places:
        name, _, line = place.removeprefix(f"{PACKAGE}/").partition(":")
        path = Path(PACKAGE, name)
        if not path.exists():
            raise SystemExit(f"{path} does not exist")
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            found += [mutant for mutant in mutants(file) if not line or mutant.line == int(line)]
    return random.Random(seed).sample(found, min(sample, len(found)))


def main(argv: Sequence[str] | None = None) -> int:
    arguments = _parser().parse_args(argv)
    drawn = chosen(arguments.places or DECIDING, arguments.sample, arguments.seed)
    covering = cover(files_beside(drawn), arguments.jobs)
    for name in HEAVY:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    _tell(f"{len(drawn)} mutants, seed {arguments.seed}")
    outcomes: list[Outcome] = []
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        trial = Trial(covering, Path(folder), arguments.jobs, arguments.budget)
        del covering
        for outcome in trial.run(drawn):
            outcomes.append(outcome)
            if not outcome.is_killed:
                _tell(f"{outcome.kind} ({outcome.tests} tests): {outcome.mutant}")
            elif arguments.verbose:
                _tell(f"{outcome.kind} by {outcome.by}: {outcome.mutant}")
            _progress(outcomes, len(drawn))
    return _concluded(outcomes, arguments.at_least)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="fuzz.mutants", description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("places", metavar="FOLDER", nargs="*", help="of the package; a file, or FILE:LINE")
    add("--sample", type=int, default=200, metavar="N", help="mutants at most (200)")
    add("--seed", type=int, default=1, metavar="S", help="that draws them (1)")
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="at once")
    add("--budget", type=float, default=BUDGET, metavar="SECONDS", help="of tests for each (20)")
    add("--at-least", type=float, default=0.0, metavar="PERCENT", help="killed; else fail")
    add("--verbose", action="store_true", help="print what killed each")
    return parser


def _concluded(outcomes: list[Outcome], floor: float) -> int:
    killed = sum(outcome.is_killed for outcome in outcomes)
    share = 100 * killed / len(outcomes) if outcomes else 100.0
    kinds = {kind: sum(outcome.kind == kind for outcome in outcomes) for kind in ("hung", "broken")}
    print(
        f"{killed} of {len(outcomes)} mutants were killed, {share:.1f} %: "
        f"{kinds['hung']} of them hung, {kinds['broken']} could not be imported"
    )
    for outcome in sorted(outcomes, key=lambda each: (each.mutant.path, each.mutant.line)):
        if not outcome.is_killed:
            print(f"  {outcome.kind:9} {outcome.mutant}")
    return int(share < floor)


def _progress(outcomes: list[Outcome], count: int) -> None:
    if sys.stderr.isatty():
        left = sum(not outcome.is_killed for outcome in outcomes)
        print(f"\r{len(outcomes)} of {count}, {left} survive ", end="", file=sys.stderr, flush=True)


def _tell(text: str) -> None:
    before = "\r\x1b[K" if sys.stderr.isatty() else ""
    print(before + text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
