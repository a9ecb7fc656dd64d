"""
Change one place of the package at a time, and see whether a test fails.

    ./run mutants FOLDER [FOLDER ...] [--sample N] [--seed S]

cosmic-ray makes the mutants and runs their tests; here places are drawn, with one mutant for each,
and tests are chosen. The tests of the folders of the same name, or of those behind `--tests`, run
once with pytest-cov, which records the lines that each executes. Of those of the changed line, the
fastest run, preferably from files named as the module, and the first failure ends it. Mutants are
made in copies of the tree, one for each process. What survives is printed as a diff. Tests of other
folders may notice it; and it is no gap if it changes only how much is done at once or how long a
pause is: no test should repeat these values.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from functools import cache
from operator import attrgetter
from pathlib import Path
from typing import Any

import parso
from cosmic_ray import plugins
from cosmic_ray.commands.init import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.operators.operator import Operator
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, WorkResult
from coverage import CoverageData

PACKAGE, BUILD = Path("libmodbus_py"), Path("build/mutants")
SECONDS = 20.0  # of tests for one mutant, measured without the mutant
MEMORY = 4 << 30  # bytes: the tests of a mutant that collects for ever fail there


class RemoveStatement(Operator):
    """Remove a call, or an assignment to what is no name: cosmic-ray removes no statements."""

    def mutation_positions(self, node: Any) -> Iterator[Any]:
        if node.type == "simple_stmt":
            statement = node.children[0]
            is_call = statement.type == "atom_expr" and statement.get_last_leaf().value == ")"
            if is_call or (statement.type == "expr_stmt" and statement.children[0].type != "name"):
                yield statement.start_pos, statement.end_pos

    def mutate(self, node: Any, index: int) -> Any:
        first = node.get_first_leaf()
        node.children[0] = parso.python.tree.Name("pass", first.start_pos, first.prefix)
        return node

    @classmethod
    def examples(cls) -> Any:
        return ()


plugins.OPERATOR_PROVIDERS["fuzz"] = {"RemoveStatement": RemoveStatement}


@cache
def nodes(path: Path) -> list[Any]:
    return list(ast.walk(ast.parse(path.read_text())))


@cache
def texts(path: Path) -> list[Any]:
    """Return where nothing is changed: annotations, overloads, decorators, errors and logs."""
    found: list[Any] = []
    for node in nodes(path):
        decorators = getattr(node, "decorator_list", [])
        found += [node] if "overload" in map(ast.unparse, decorators) else decorators
        found += [getattr(node, name, None) for name in ("annotation", "returns")]
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr) or (
            isinstance(node, ast.Call) and re.match("logger|warn", ast.unparse(node.func))
        ):
            found.append(node)
    ends = attrgetter("lineno", "col_offset"), attrgetter("end_lineno", "end_col_offset")
    return [[end(node) for end in ends] for node in found if node]


def draw(folders: Sequence[str], sample: int, seed: int) -> list[MutationSpec]:
    """Return a mutant for each of the drawn places of folders of the package, or of files."""
    paths = [PACKAGE / folder for folder in folders]
    files = [file for path in paths for file in sorted(path.rglob("*.py")) or [path]]
    with tempfile.TemporaryDirectory() as folder, use_db(f"{folder}/db", WorkDB.Mode.create) as db:
        init([file for file in files if not file.name.endswith("_blocking.py")], db, {})
        mutations = [item.mutations[0] for item in db.work_items]
    places = defaultdict(list)
    order = attrgetter("module_path", "start_pos", "operator_name", "occurrence")
    for each in sorted(mutations, key=order):
        is_text = any(start <= each.start_pos < end for start, end in texts(each.module_path))
        if not is_text and not each.operator_name.endswith("RemoveDecorator"):
            places[each.module_path, each.start_pos].append(each)
    generator = random.Random(seed)
    chosen = generator.sample(list(places.values()), min(sample, len(places)))
    return [generator.choice(mutants) for mutants in chosen]


class Tests:
    """Which tests execute which lines, and their seconds; those that fail are left out."""

    def __init__(self, folders: Sequence[str], jobs: int) -> None:
        BUILD.mkdir(parents=True, exist_ok=True)
        name = "+".join(folder.replace("/", "-") for folder in folders)
        log, data = BUILD / f"{name}.log", (BUILD / f"{name}.coverage").resolve()
        sources = [*PACKAGE.rglob("*.py"), *Path("tests").rglob("*.py")]
        if not log.exists() or max(map(os.path.getmtime, sources)) > log.stat().st_mtime:
            print("running the tests, to see which lines they execute", flush=True)
            command = [sys.executable, *f"-m pytest -n{jobs} -vv --durations=0".split()]
            command += ["--cov", "--cov-context=test", "--cov-report=", "--cov-fail-under=0"]
            command += [f"tests/{folder}" for folder in folders]
            environment = {**os.environ, "COVERAGE_FILE": str(data), "COVERAGE_CORE": "ctrace"}
            with log.with_suffix(".new").open("w") as output:
                subprocess.run(command, stdout=output, env=environment, check=False)
            log.with_suffix(".new").rename(log)
        text = log.read_text(errors="replace")
        failed = re.findall(r"^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", text, re.M)
        self.seconds: dict[str, float] = defaultdict(float)
        for seconds, test in re.findall(r"^([\d.]+)s \w+ +(tests/.*)$", text, re.M):
            self.seconds[test] += float(seconds) + 0.005
        self._known = self.seconds.keys() - failed
        self._data = CoverageData(str(data))
        self._data.read()

    def choose(self, mutation: MutationSpec) -> list[str]:
        """Return the tests of a statement, or all tests of its file if no test executes it."""
        path, line = mutation.module_path, mutation.start_pos[0]
        first = max(n.lineno for n in nodes(path) if isinstance(n, ast.stmt) and n.lineno <= line)
        contexts = self._data.contexts_by_lineno(str(path.resolve()))
        namesakes = {test for test in self._known if path.stem in test.partition("::")[0]}
        for lines in (range(first, mutation.end_pos[0] + 1), contexts):
            names = {name.rpartition("|")[0] for n in lines for name in contexts.get(n, ())}
            if tests := names & self._known:
                break
        if lines is contexts:
            tests = tests | namesakes
        cost = {test: self.seconds[test] / (10 if test in namesakes else 1) for test in tests}
        total, chosen = 0.0, []
        for test in sorted(tests, key=lambda test: (cost[test], test)):
            total += self.seconds[test]
            if total < SECONDS or not chosen:
                chosen.append(test)
        return chosen


def copy_tree(folder: str) -> None:
    """Give a process that tries mutants its own copy of the tree, and of the temporary folder."""
    tree, temporary = Path(folder, str(os.getpid())), Path(folder, f"{os.getpid()}t")
    left_out = shutil.ignore_patterns(".git", ".venv", "build", "site", "findings", ".*_cache")
    shutil.copytree(".", tree, ignore=left_out)
    temporary.mkdir()
    os.chdir(tree)
    os.environ.update(PYTHONPATH=str(tree), TMPDIR=str(temporary))
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, resource.RLIM_INFINITY))


def try_mutant(mutation: MutationSpec, tests: list[str], seconds: float) -> WorkResult:
    Path("tests.txt").write_text("\n".join(tests))
    command = f"{shlex.quote(sys.executable)} -m pytest -xq -pno:xdist -pno:cacheprovider"
    command = f"{command} @tests.txt" if tests else "true"
    return mutate_and_test([mutation], command, 30 + 5 * seconds)


def main() -> None:
    parser = argparse.ArgumentParser(prog="./run mutants", description=__doc__.split("\n\n")[0])
    add = parser.add_argument
    add("folders", metavar="FOLDER", nargs="+", help="of the package, or a file")
    add("--sample", type=int, default=200, metavar="N", help="mutants at most (200)")
    add("--seed", type=int, default=1, metavar="S", help="that draws them (1)")
    add("--tests", nargs="+", metavar="FOLDER", help="of tests, in place of those of the same name")
    add("--jobs", type=int, default=os.cpu_count() or 1, metavar="N", help="at once")
    arguments = parser.parse_args()
    mutants = draw(arguments.folders, arguments.sample, arguments.seed)
    tests = Tests(arguments.tests or arguments.folders, arguments.jobs)
    killed, jobs = 0, {}
    with (
        tempfile.TemporaryDirectory(prefix="mutants-") as folder,
        ProcessPoolExecutor(arguments.jobs, initializer=copy_tree, initargs=(folder,)) as pool,
    ):
        for mutant in mutants:
            chosen = tests.choose(mutant)
            seconds = sum(tests.seconds[test] for test in chosen)
            jobs[pool.submit(try_mutant, mutant, chosen, seconds)] = len(chosen)
        for job in as_completed(jobs):
            result = job.result()
            if result.test_outcome is None:
                raise RuntimeError(result.output)
            killed += result.is_killed
            if not result.is_killed:
                print(f"\nno failure of {jobs[job]} tests:\n{result.diff}", flush=True)
    print(f"\n{killed} of {len(mutants)} mutants were killed: {killed / len(mutants):.1%}")


if __name__ == "__main__":
    main()
