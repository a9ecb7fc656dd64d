"""
Rules of this repository that no linter knows.

The numbers in capitals count what breaks a rule and was there before it. They may only fall:
whoever mends one lowers the number.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from functools import cache, cached_property
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "libmodbus_py"

LONGEST = 60
"""Lines of a function."""

LONG_FUNCTIONS = 6
"""Of tests and their helpers; the package has none."""

REAL_SLEEPS = 75
"""Calls of `sleep` with a number, where real seconds pass."""

MERELY_RUN = 0
"""Tests that fail only if something is raised."""

FIRST_WORDS = {
    *("Give", "Have", "How", "It", "Nobody", "Somebody", "Tell", "What", "Whether", "Where"),
    *("Who", "Whoever", "Whom", "Whose"),
}
"""No docstring of the package begins with one of these, because no plain sentence follows."""

WORDS = {
    *("anybody", "circles", "everybody", "heed", "heeded", "manner", "nobody", "patience"),
    *("somebody", "standing", "troubles", "whereabouts", "whoever", "whom"),
}
"""Words that have plainer ones; no docstring, comment or message of the package uses them."""

Function = ast.FunctionDef | ast.AsyncFunctionDef

# Where these come from, seconds are simulated.
CLOCKS = ("tests.simulation", "tests.services.workers.memory_engine")

# What fails a test, besides `assert`; `timeout` fails what does not happen.
FAILING = {"raises", "fail", "warns", "timeout", "fnmatch_lines", "no_fnmatch_line", "wait_for"}


@cache
def parsed(path: Path) -> ast.Module:
    """Return the syntax tree of a file, which several tests look at."""
    return ast.parse(path.read_text())


class Module:
    """A Python file of this repository, by its dotted name."""

    def __init__(self, path: Path) -> None:
        self.path = path.relative_to(ROOT)
        self.name = ".".join(self.path.with_suffix("").parts)
        self.tree = parsed(path)

    @cached_property
    def functions(self) -> list[Function]:
        return [node for node in ast.walk(self.tree) if isinstance(node, Function)]

    @cached_property
    def definitions(self) -> dict[str, list[ast.AST]]:
        found: dict[str, list[ast.AST]] = {}
        for node in ast.walk(self.tree):
            if isinstance(node, Function | ast.ClassDef):
                found.setdefault(node.name, []).append(node)
        return found

    @cached_property
    def imported(self) -> dict[str, tuple[str, str]]:
        """Return the imported names: name -> module, and the name there."""
        return {
            alias.asname or alias.name: (self._source(node), alias.name)
            for node in ast.walk(self.tree)
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        }

    def _source(self, node: ast.ImportFrom) -> str:
        package = self.name.split(".")[: -node.level] if node.level else []
        return ".".join([*package, *filter(None, [node.module])])

    @property
    def tests(self) -> Iterator[Function]:
        """Yield the functions that pytest collects."""
        if self.path.name.startswith("test_"):
            for node in self.tree.body:
                for inner in node.body if isinstance(node, ast.ClassDef) else [node]:
                    if isinstance(inner, Function) and inner.name.startswith("test_"):
                        yield inner


@cache
def modules(*folders: str) -> dict[str, Module]:
    found = [Module(path) for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]
    return {each.name: each for each in found}


def of_tests() -> dict[str, Module]:
    return modules("tests", "fuzz")


@pytest.fixture(scope="module", autouse=True)
def _forgotten() -> Iterator[None]:
    """Keep the syntax trees, which take much memory, as long as these tests run."""
    yield
    for known in (modules, parsed, failures):
        known.cache_clear()


def _bases(node: ast.ClassDef) -> set[str]:
    return {base.id for base in node.bases if isinstance(base, ast.Name)}


@cache
def failures() -> set[str]:
    """Return the names of classes of exceptions that fail a test."""
    return {"AssertionError"} | {
        node.name
        for module in of_tests().values()
        for node in ast.walk(module.tree)
        if isinstance(node, ast.ClassDef) and "AssertionError" in _bases(node)
    }


class Assertions:
    """Which functions of the tests can fail a test by themselves, or through others they call."""

    def __init__(self) -> None:
        self._known: dict[ast.AST, bool] = {}

    def has(self, module: Module, node: ast.AST) -> bool:
        if node not in self._known:
            self._known[node] = False  # As long as it is not decided: functions call each other.
            self._known[node] = any(map(_fails, ast.walk(node))) or any(
                self.has(*each) for each in self._used(module, node) if each[1] is not node
            )
        return self._known[node]

    def _used(self, module: Module, node: ast.AST) -> Iterator[tuple[Module, ast.AST]]:
        """Yield the helpers, methods and fixtures that a function names."""
        sources = {name for name, _ in module.imported.values()}
        for inner in ast.walk(node):
            match inner:
                case ast.Name(id=name):
                    places = [module.name, module.imported.get(name, ("", ""))[0]]
                case ast.Attribute(attr=name):
                    places = [module.name, *sources]
                case ast.arg(arg=name):
                    places = [module.name, *_conftests(module)]
                case _:
                    continue
            for place in places:
                if found := of_tests().get(place):
                    for definition in found.definitions.get(name, ()):
                        yield found, definition


def _conftests(module: Module) -> Iterator[str]:
    parts = module.name.split(".")[:-1]
    for count in range(len(parts), 0, -1):
        yield ".".join([*parts[:count], "conftest"])


def _fails(node: ast.AST) -> bool:
    """Return True if a piece of code alone can fail a test."""
    match node:
        case ast.Assert():
            return True
        case ast.Raise(exc=ast.Call(func=ast.Name(id=name))):
            return name in failures()
        case ast.Raise(exc=ast.Subscript() | ast.Attribute()):
            return True  # What was kept before, such as the first rule that was broken.
        case ast.Attribute(attr=name):
            return name in FAILING or name.startswith("assert_")
        case ast.keyword(arg="check", value=ast.Constant(value=True)):
            return True
    return False


def too_long(found: dict[str, Module]) -> list[str]:
    return [
        f"{module.path}:{function.lineno}: {function.name} has {lines} lines"
        for module in found.values()
        for function in module.functions
        if (lines := (function.end_lineno or 0) - function.lineno + 1) > LONGEST
    ]


def test_no_function_of_the_package_is_long() -> None:
    assert too_long(modules("libmodbus_py", "bench", "packaging")) == []


def test_few_functions_of_tests_are_long() -> None:
    found = too_long(of_tests())
    assert len(found) <= LONG_FUNCTIONS, found


def test_each_file_of_the_package_is_imported_by_another_one() -> None:
    """A file that no other file imports, or names in a table, does not belong to the package."""
    named = set()
    for path in [*PACKAGE.rglob("*.py*"), ROOT / "pyproject.toml", ROOT / "build_ffi.py"]:
        if path.parent.name == "__pycache__":  # where other tests write at the same time
            continue
        text = path.read_text()
        tree = parsed(path) if path.suffix != ".toml" else ast.Module([], [])
        named |= set(_imported_by(path, tree))
        named |= {
            node.value
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
        }
        named |= set(text.replace('"', " ").replace(":", " ").split()) if not tree.body else set()
    named = {given.strip(".") for given in named}
    files = [
        path.relative_to(ROOT)
        for path in PACKAGE.rglob("*.py")
        if path.name not in ("__init__.py", "__main__.py")
        if path.stem.isidentifier()  # PyInstaller finds its hook by the name
    ]
    assert [str(path) for path in files if named.isdisjoint(_endings(path))] == []


def _endings(path: Path) -> Iterator[str]:
    """Yield the dotted names by which a module is imported from somewhere."""
    parts = path.with_suffix("").parts
    for first in range(len(parts)):
        yield ".".join(parts[first:])


def _imported_by(path: Path, tree: ast.Module) -> Iterator[str]:
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = list(package[: len(package) - node.level + 1]) if node.level else []
            module = ".".join([*base, *filter(None, [node.module])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def test_each_test_can_fail() -> None:
    assertions = Assertions()
    found = [
        f"{module.path}:{function.lineno}: {function.name}"
        for module in of_tests().values()
        for function in module.tests
        if not assertions.has(module, function)
    ]
    assert len(found) <= MERELY_RUN, found


def test_what_can_fail_is_told_from_what_cannot() -> None:
    tree = ast.parse(
        """
def check(value):
    assert value

def through_another():
    check(1)

def calls_only():
    print(1)

def circle():
    circle()
"""
    )
    module = Module(Path(__file__))
    module.__dict__.update(tree=tree, name="tests.made_up")
    of_tests()[module.name] = module
    try:
        found = {each.name: Assertions().has(module, each) for each in module.functions}
    finally:
        del of_tests()[module.name]
    expected = {"check": True, "through_another": True, "calls_only": False, "circle": False}
    assert found == expected


def test_few_tests_wait_for_real_seconds() -> None:
    found = [
        f"{module.path}:{line}"
        for module in of_tests().values()
        if module.name.startswith("tests.")
        and not any(source.startswith(CLOCKS) for source, _ in module.imported.values())
        and not module.name.startswith(CLOCKS)
        for line in _sleeps(module.tree)
    ]
    assert len(found) <= REAL_SLEEPS, f"{len(found)}: {found}"


def _sleeps(tree: ast.AST) -> Iterator[int]:
    """Yield the lines that sleep for a number of seconds."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(
                func=ast.Attribute(attr="sleep") | ast.Name(id="sleep"),
                args=[ast.Constant(value=int() | float() as seconds)],
            ) if seconds:
                yield node.lineno


def test_docstrings_begin_with_a_subject_or_a_plain_verb() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {text.split()[0]}"
        for path in PACKAGE.rglob("*.py")
        for text in _docstrings(path)
        if text.split()[0] in FIRST_WORDS
    ]
    assert found == []


def test_no_sentence_uses_a_banned_word() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {sentence.strip()[:80]}"
        for path in PACKAGE.rglob("*.py")
        for sentence in _prose(path)
        if WORDS & set(re.findall("[a-z]+", sentence.lower()))
    ]
    assert found == []


def test_a_class_name_exists_once_in_the_package() -> None:
    places = defaultdict(list)
    for module in modules("libmodbus_py").values():
        for node in ast.walk(module.tree):
            if isinstance(node, ast.ClassDef):
                places[node.name].append(str(module.path))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def _docstrings(path: Path) -> Iterator[str]:
    """Yield the docstrings of a file, those of attributes included."""
    for node in ast.walk(parsed(path)):
        match node:
            case ast.Expr(value=ast.Constant(value=str(text))) if text.strip():
                yield text


def _prose(path: Path) -> Iterator[str]:
    """Yield the docstrings, comments, messages and other strings of a file."""
    source = path.read_text()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string
    for node in ast.walk(parsed(path)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def test_docstrings_have_no_quotation_marks_of_other_texts() -> None:
    """A text in pieces, as an error has, is not a docstring: its quotation marks would be shown."""
    found = [
        str(path.relative_to(ROOT))
        for path in (ROOT / "libmodbus_py").rglob("*.py")
        for node in ast.walk(parsed(path))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        if re.search(r'"\n *" ', ast.get_docstring(node, clean=False) or "")
    ]
    assert found == []
