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
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache, cached_property
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "libmodbus_py"

LONGEST_FILE = 500
"""Lines of a file of the package, which is one subject."""

SHORTEST_FILE = 60
"""Lines of one that is neither public nor a table: less belongs to the file that uses it."""

UNITS = ("_S", "_MS", "_NS", "_BYTES", "_BITS", "_LINES", "_CHARACTERS", "_FLAG", "_TAG")
"""Ends of names of constants that name a unit."""

EXCEPTIONS = Path(__file__).with_suffix(".txt")
"""What broke a rule when the rule was made."""

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
CLOCKS = ("tests.simulation",)

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
                    places = [module.name, *_with_fixtures(module)]
                case _:
                    continue
            for place in places:
                if found := of_tests().get(place):
                    for definition in found.definitions.get(name, ()):
                        yield found, definition


def _with_fixtures(module: Module) -> Iterator[str]:
    """Yield the modules whose fixtures the tests of a module have."""
    parts = module.name.split(".")[:-1]
    for count in range(len(parts), 0, -1):
        yield ".".join([*parts[:count], "conftest"])
    yield "tests.support.golden"  # a plugin of all tests


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


# --- files, public names, constants ----------------------------------------------------------


def sizes() -> Iterator[str]:
    """Yield the files that are too short or too long for one subject."""
    for module in modules("libmodbus_py").values():
        lines = len((ROOT / module.path).read_text().splitlines())
        if lines > LONGEST_FILE:
            yield f"long {module.path}"
        elif lines < SHORTEST_FILE and not (_is_public(module.path) or _is_table(module.tree)):
            yield f"short {module.path}"


def _is_public(path: Path) -> bool:
    """Return True for what programs import or run, and for what describes a folder."""
    is_at_the_top = path.parent == Path("libmodbus_py")
    return is_at_the_top or path.name in ("__init__.py", "__main__.py") or "frozen" in path.parts


def _is_table(tree: ast.Module) -> bool:
    """Return True for a file that defines nothing but values."""
    return not any(isinstance(node, Function | ast.ClassDef) for node in tree.body)


def unused_names() -> Iterator[str]:
    """Yield the names in ``__all__`` that no other file uses."""
    files = [path for path in _sources() if path.suffix != ".md"]
    used = {path: _identifiers(path) for path in files}
    users = Counter(name for names in used.values() for name in names)
    pages = {name for path in (ROOT / "docs").rglob("*.md") for name in _words(path)}
    pages |= _words(ROOT / "pyproject.toml")
    for module in modules("libmodbus_py").values():
        if module.path.name == "__init__.py":  # the public names of a folder
            continue
        own = used[ROOT / module.path]
        for name in _exported(module.tree):
            if users[name] == (name in own) and name not in pages:
                yield f"unused {module.path} {name}"


def _sources() -> Iterator[Path]:
    for folder in ("libmodbus_py", "tests", "fuzz", "bench", "packaging", "examples"):
        yield from (ROOT / folder).rglob("*.py")
    yield from PACKAGE.rglob("*.pyi")


def _identifiers(path: Path) -> frozenset[str]:
    """Return the names that a file uses, without those in its own ``__all__``."""
    found = set()
    for node in ast.walk(parsed(path)):
        match node:
            case ast.Name(id=name) | ast.Attribute(attr=name) | ast.alias(name=name):
                found.add(name)
            case ast.FunctionDef(name=name) | ast.ClassDef(name=name):
                found.add(name)
    return frozenset(found)


def _words(path: Path) -> set[str]:
    return set(re.findall(r"\w+", path.read_text()))


def _exported(tree: ast.Module) -> list[str]:
    for node in tree.body:
        match node:
            case ast.Assign(targets=[ast.Name(id="__all__")], value=ast.List() as names):
                return [str(ast.literal_eval(name)) for name in names.elts]
    return []


def bare_constants() -> Iterator[str]:
    """Yield the numbers of modules that have neither a unit in their name nor a reason."""
    for module in modules("libmodbus_py").values():
        lines = (ROOT / module.path).read_text().splitlines()
        for number, node in enumerate(module.tree.body):
            name = _name_of_number(node)
            if name is None or name.endswith(UNITS):
                continue
            following = module.tree.body[number + 1 :][:1]
            has_docstring = following != [] and isinstance(following[0], ast.Expr)
            if not has_docstring and not _has_comment(lines, node.lineno - 1):
                yield f"bare {module.path} {name}"


def _name_of_number(node: ast.stmt) -> str | None:
    match node:
        case ast.Assign(targets=[ast.Name(id=name)], value=value):
            pass
        case ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value):
            pass
        case _:
            return None
    is_number = name.isupper() and any(
        isinstance(inner, ast.Constant) and type(inner.value) in (int, float)
        for inner in (ast.walk(value) if isinstance(value, ast.BinOp) else [value])
    )
    return name if is_number else None


def _has_comment(lines: list[str], index: int) -> bool:
    """Return True if a comment stands above a line, or above its neighbours, or behind it."""
    if "  # " in lines[index]:
        return True
    while index > 0 and lines[index - 1].strip():
        index -= 1
        if lines[index].startswith("#"):
            return True
    return False


RULES = {"short": sizes, "long": sizes, "unused": unused_names, "bare": bare_constants}


@pytest.mark.parametrize("rule", RULES)
def test_only_listed_places_break_a_rule_and_each_of_them_does(rule: str) -> None:
    """`EXCEPTIONS` can only become shorter: ``python -m tests.test_house`` removes lines."""
    listed = {line for line in EXCEPTIONS.read_text().splitlines() if line.startswith(f"{rule} ")}
    found = {line for line in RULES[rule]() if line.startswith(f"{rule} ")}
    assert sorted(found - listed) == [], "mend these"
    assert sorted(listed - found) == [], "remove these lines"


def test_the_rules_find_what_breaks_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = "import this_module"
    bad = "__all__ = ['nobody_uses_it']\n\nSIZE = 5\n\n\ndef nobody_uses_it():\n    pass\n"
    good = "__all__ = ['RATE_S']\n\n# Why.\nSIZE = 5\nOTHER = 6 * 7\n\nRATE_S = 5\n" + here
    folder = tmp_path / "libmodbus_py" / "folder"
    folder.mkdir(parents=True)
    for name in ("tests", "docs"):
        (tmp_path / name).mkdir()
    (tmp_path / "pyproject.toml").touch()
    (folder / "bad.py").write_text(bad)
    (folder / "good.py").write_text(good)
    (folder / "long.py").write_text("from .good import RATE_S\n" + "\n" * LONGEST_FILE)
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    monkeypatch.setitem(globals(), "PACKAGE", tmp_path / "libmodbus_py")
    modules.cache_clear()
    try:
        found = {line for rule in (sizes, unused_names, bare_constants) for line in rule()}
    finally:
        modules.cache_clear()
    place = "libmodbus_py/folder/"
    assert found == {
        f"short {place}bad.py",
        f"long {place}long.py",
        f"unused {place}bad.py nobody_uses_it",
        f"bare {place}bad.py SIZE",
    }


# --- imports and tests -----------------------------------------------------------------------


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
    twice = {name for name, found in places.items() if len(found) > 1}
    assert twice == set()


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


def main() -> None:
    """Remove the exceptions that no longer break a rule."""
    found = {line for rule in set(RULES.values()) for line in rule()}
    kept = [line for line in EXCEPTIONS.read_text().splitlines() if line in found]
    EXCEPTIONS.write_text("".join(f"{line}\n" for line in kept))


if __name__ == "__main__":
    main()
