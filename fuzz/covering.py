"""
Which tests execute which lines: a plugin for pytest that writes it down, and what reads it again.

Lines are counted from the beginning of their function. So what was written down holds as long as
the text of a function does, wherever the function stands in its file.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from coverage import Coverage

PACKAGE = "libmodbus_py"
FOLDER = "MUTANTS_COVERING"
"""The environment variable that names the folder for what is written down."""

FORMAT = 2
"""Of the file that `Covering` writes; one of another format is not read."""


@dataclass(frozen=True)
class Function:
    """A function of a file: the line of its `def`, its last line, and what its text is."""

    key: str
    first: int
    last: int
    digest: str


def functions(path: Path) -> list[Function]:
    """Return the functions of a file; those within others follow these."""
    source = path.read_text()
    lines = source.splitlines()

    def found(node: ast.AST, name: str) -> Iterator[Function]:
        for child in ast.iter_child_nodes(node):
            inner = name
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
                inner = f"{name}.{child.name}"
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                last = child.end_lineno or child.lineno
                text = "\n".join(lines[child.lineno - 1 : last])
                digest = hashlib.sha1(text.encode()).hexdigest()[:12]
                yield Function(f"{path}:{inner}", child.lineno, last, digest)
            yield from found(child, inner)

    return list(found(ast.parse(source), ""))


def digest(path: Path) -> str:
    return hashlib.sha1(path.read_bytes()).hexdigest()


class _Recorder:
    """Writes down the lines that each test executes, and how long it takes."""

    def __init__(self, coverage: Coverage, folder: Path) -> None:
        self._coverage = coverage
        self._folder = folder
        self._seconds: dict[str, float] = {}
        self._failed: set[str] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        self._coverage.switch_context(item.nodeid)
        begun = time.perf_counter()
        try:
            return (yield)
        finally:
            self._seconds[item.nodeid] = time.perf_counter() - begun
            self._coverage.switch_context("")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.outcome != "passed":
            self._failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self._coverage.stop()
        passed = {key: value for key, value in self._seconds.items() if key not in self._failed}
        data = self._coverage.get_data()
        root = Path.cwd()
        lines = {
            str(Path(name).relative_to(root)): _by_line(data.contexts_by_lineno(name), passed)
            for name in data.measured_files()
        }
        made = {"seconds": passed, "lines": lines}
        (self._folder / f"part-{os.getpid()}.json").write_text(json.dumps(made))


def _by_line(contexts: dict[int, list[str]], passed: dict[str, float]) -> dict[int, list[str]]:
    return {
        line: kept
        for line, names in contexts.items()
        if (kept := [n for n in names if n in passed])
    }


def pytest_configure(config: pytest.Config) -> None:
    """Record in each process that runs tests; xdist's first process runs none."""
    folder = os.environ.get(FOLDER)
    is_first = getattr(config.option, "numprocesses", None) and not hasattr(config, "workerinput")
    if not folder or is_first:
        return
    import coverage

    made = coverage.Coverage(
        data_file=None, config_file=False, include=[f"{Path.cwd()}/{PACKAGE}/*"], messages=False
    )
    made.start()
    config.pluginmanager.register(_Recorder(made, Path(folder)))


@dataclass
class Covering:
    """
    What is known of the tests.

    Attributes:
        files: the digest of each test file when its tests ran.
        seconds: of each test that passed.
        tests: of each function, by line within it, the tests that execute the line.
        digests: of each function when its tests ran.
    """

    files: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    tests: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    digests: dict[str, dict[str, str]] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> Covering:
        if not path.exists():
            return cls()
        written = json.loads(path.read_text())
        if written.pop("format", 1) != FORMAT:
            return cls()
        names = list(written["seconds"])
        tests = {
            key: {line: [names[number] for number in entry] for line, entry in lines.items()}
            for key, lines in written.pop("tests").items()
        }
        return cls(tests=tests, **written)

    def write(self, path: Path) -> None:
        """Write all to a file, with numbers in place of the names of tests, which are long."""
        number = {name: place for place, name in enumerate(self.seconds)}
        tests = {
            key: {line: [number[test] for test in entry] for line, entry in lines.items()}
            for key, lines in self.tests.items()
        }
        path.write_text(json.dumps({"format": FORMAT, **vars(self), "tests": tests}))

    def stale(self, paths: list[Path]) -> list[Path]:
        """Return the test files that are new, or have changed."""
        return [path for path in paths if self.files.get(str(path)) != digest(path)]

    def forget(self, paths: list[Path]) -> None:
        """Lose what is known of some test files."""
        names = {str(path) for path in paths}
        for name in names:
            self.files.pop(name, None)
        self.seconds = {k: v for k, v in self.seconds.items() if _file(k) not in names}
        for lines in self.tests.values():
            for line, tests in lines.items():
                lines[line] = [test for test in tests if _file(test) not in names]
        for digests in self.digests.values():
            for name in names:
                digests.pop(name, None)

    def add(self, parts: list[dict[str, Any]], path: Path) -> None:
        """Take what was written down while the tests of a file ran, if anything was."""
        if not parts:
            return
        self.files[str(path)] = digest(path)
        for part in parts:
            self.seconds.update(part["seconds"])
            for name, lines in part["lines"].items():
                self._place(Path(name), {int(line): tests for line, tests in lines.items()})

    def _place(self, path: Path, lines: dict[int, list[str]]) -> None:
        for function in functions(path):
            known = self.tests.setdefault(function.key, {})
            seen = self.digests.setdefault(function.key, {})
            # Its first line runs when the file is imported.
            for line in range(function.first + 1, function.last + 1):
                if tests := lines.get(line):
                    known.setdefault(str(line - function.first), []).extend(tests)
                    seen.update({_file(test): function.digest for test in tests})

    def of_lines(self, path: Path, first: int, last: int) -> set[str]:
        """Return the tests that execute any of these lines, which stand in one function."""
        holding = [item for item in functions(path) if item.first < first <= item.last]
        if not holding:
            return set()
        function = holding[-1]
        lines, seen = self.tests.get(function.key, {}), self.digests.get(function.key, {})
        exact = {
            test
            for line in range(first, last + 1)
            for test in lines.get(str(line - function.first), ())
            if seen.get(_file(test)) == function.digest
        }
        changed = {
            test
            for tests in lines.values()
            for test in tests
            if seen.get(_file(test)) != function.digest
        }
        return exact | changed

    def of_file(self, path: Path) -> set[str]:
        """Return the tests that execute any function of a file."""
        found: dict[str, None] = defaultdict()
        for function in functions(path):
            for tests in self.tests.get(function.key, {}).values():
                found.update(dict.fromkeys(tests))
        return set(found)


def _file(test: str) -> str:
    return test.split("::", 1)[0]


if "COVERAGE_CORE" not in os.environ and sys.version_info >= (3, 12):
    # sys.monitoring tells of a line once, and not to each context.
    os.environ["COVERAGE_CORE"] = "ctrace"
