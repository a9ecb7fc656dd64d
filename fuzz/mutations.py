"""
The mutants of a source file: copies that each differ from the file in one expression or statement.

A mutant is made by replacing the text of one syntax node, so that all line numbers stay. What no
test needs to look at is left alone: docstrings, texts, annotations, decorators, what is raised or
logged, how an object is printed, and what `_FREE` names.

Some constants are tuning: how much is done at once, where a bound of memory lies, how long a pause
is. A value a little larger gives the same results with other costs, and the documentation promises
none of them, so that a test of the exact value would only repeat it. `TUNING` names them, and their
values are left alone, and so is whether a bound itself is within. What uses them is not: a bound
that is not held, or a pause that is not made, must fail a test. All other constants are promised,
and a test has to look at their exact values.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

__all__ = ["TUNING", "Mutant", "mutants"]


@dataclass(frozen=True)
class Mutant:
    """
    One change of a file.

    Attributes:
        path: of the file.
        lines: of the statement that is changed, or of its head: the first and the last one.
        names: what the statement defines, if it stands in no function.
        node: what is replaced.
        operator: the kind of the change.
        text: what stands there instead.
    """

    path: Path
    lines: tuple[int, int]
    names: frozenset[str]
    node: ast.AST
    operator: str
    text: str

    def __str__(self) -> str:
        place = f"{self.path}:{self.line}"
        return f"{place}: {self.operator}: {_short(ast.unparse(self.node))} -> {_short(self.text)}"

    @property
    def line(self) -> int:
        assert isinstance(self.node, ast.expr | ast.stmt)
        return self.node.lineno

    @property
    def source(self) -> str:
        """The whole changed file."""
        lines = [line.encode() for line in self.path.read_text().splitlines(keepends=True)]
        return _replaced(lines, self.node, self.text)


_BOUNDARIES: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
}
_OPPOSITES: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.BitXor: ast.BitAnd,
}
_CALLS = {"min": "max", "max": "min", "any": "all", "all": "any"}
_PRINTED = {"__repr__", "__str__", "__format__"}
_LOGS = {"logger", "log", "logging", "warnings"}

_FREE = {
    "covariant": "for type checkers",
    "is_wide": "a column of the page that a narrow window leaves out",
    "maxsize": "of a cache: how much is calculated once only",
    "repr": "how an object is printed",
    "stacklevel": "which line of a program a log or a warning names",
    "strict": "of zip: an assertion that both are of the same length",
}
"""Keywords of calls whose values no test has to look at, and why."""

TUNING: dict[str, frozenset[str]] = {
    "of how much is done before others have their turn": frozenset(
        {
            *("AT_ONCE", "FRAMES_AT_ONCE", "FREED", "MERGED_BYTES", "MOST_AT_ONCE"),
            *("MOST_DELETED", "MOST_OF_JOURNAL", "READ_BYTES"),
            *("READ_SIZE", "RECEIVED_BYTES", "TOGETHER", "TURN_EVENTS"),
        }
    ),
    "of memory that only floods and failures reach": frozenset(
        {
            *("MARGIN", "MAX_ABANDONED", "MAX_RECEIVED"),
            *("MAX_UNASKED_BYTES", "MOST_ASKING", "MOST_ERRORS", "MOST_IN_MEMORY"),
            *("MOST_MESSAGES", "OVERHEAD"),
            *("REMEMBERED", "SPARE_DESCRIPTORS"),
        }
    ),
    "of tries, of seconds between them, and of how exactly time is kept": frozenset(
        {
            *("COARSEST_S", "EXACTNESS", "FADING", "FIRST_PAUSE_S", "FORCED_S"),
            *("GATHERED_S", "LAST_WAIT_S", "LEAVING", "LONGEST_PAUSE_S", "LOOK"),
            *("MOST_DOUBLINGS", "MOST_TRIES", "PAUSE", "QUICK_S"),
            *("SAMPLED", "SHORTEST_TRIAL_S", "SLEPT_S"),
        }
    ),
}
"""Constants whose exact values no test should repeat, by what they are bounds of."""

_TUNING = frozenset().union(*TUNING.values())
_LEFT_ALONE = _TUNING | {"TYPE_CHECKING"}

# A kind of change, and the text that stands for the node.
_Change = tuple[str, str]


def _compared(node: ast.Compare) -> Iterator[_Change]:
    if len(node.ops) != 1:
        return
    operator = type(node.ops[0])
    sides = (node.left, *node.comparators)
    is_tuning = any(isinstance(side, ast.Name) and side.id in _TUNING for side in sides)
    for name, table in (("boundary", _BOUNDARIES), ("comparison", _OPPOSITES)):
        if is_tuning and name == "boundary":
            continue  # the same as a value that is larger by one
        if other := table.get(operator):
            yield name, _text(ast.Compare(node.left, [other()], node.comparators))


def _joined(node: ast.BoolOp) -> Iterator[_Change]:
    other = ast.Or() if isinstance(node.op, ast.And) else ast.And()
    yield "and/or", _text(ast.BoolOp(other, node.values))


def _negated(node: ast.UnaryOp) -> Iterator[_Change]:
    if isinstance(node.op, ast.Not):
        yield "not", f"bool({_text(node.operand)})"
    elif isinstance(node.op, ast.USub) and not isinstance(node.operand, ast.Constant):
        yield "sign", _text(node.operand)


def _calculated(node: ast.BinOp) -> Iterator[_Change]:
    for side in (node.left, node.right):
        value = side.value if isinstance(side, ast.Constant) else None
        if isinstance(value, str) or isinstance(side, ast.JoinedStr):
            return
    if other := _ARITHMETIC.get(type(node.op)):
        yield "arithmetic", f"({_text(ast.BinOp(node.left, other(), node.right))})"


def _constant(node: ast.Constant) -> Iterator[_Change]:
    value = node.value
    if isinstance(value, bool):
        yield "constant", repr(not value)
    elif isinstance(value, int):
        yield "constant", repr(value + 1)
    elif isinstance(value, float):
        yield "constant", repr(value * 2 if value else 1.0)


def _called(node: ast.Call) -> Iterator[_Change]:
    if isinstance(node.func, ast.Name) and (other := _CALLS.get(node.func.id)):
        yield node.func.id, _text(ast.Call(ast.Name(other), node.args, node.keywords))


def _decided(node: ast.If | ast.While | ast.IfExp) -> Iterator[_Change]:
    """Negate a condition that no other operator changes; `_replaced` puts it into its place."""
    if isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
        return
    if isinstance(node.test, (ast.Name, ast.Attribute, ast.Call, ast.NamedExpr, ast.Await)):
        yield "condition", f"(not ({_text(node.test)}))"


def _done(node: ast.Expr) -> Iterator[_Change]:
    inner = node.value.value if isinstance(node.value, ast.Await) else node.value
    if isinstance(inner, ast.Call) and not _is_log(inner.func):
        yield "call removed", "pass"


def _assigned(node: ast.Assign | ast.AugAssign) -> Iterator[_Change]:
    """Lose a change of state; without a local name most programs end at once."""
    targets = node.targets if isinstance(node, ast.Assign) else [node.target]
    if isinstance(node, ast.AugAssign) or not any(isinstance(item, ast.Name) for item in targets):
        yield "assignment removed", "pass"


def _returned(node: ast.Return) -> Iterator[_Change]:
    if node.value is None:
        yield "return removed", "pass"
    elif not _is_nothing(node.value):
        yield "return value", "return None"


def _is_nothing(node: ast.expr) -> bool:
    """Return True if None in its place means the same where only its truth is tested."""
    if isinstance(node, ast.Constant):
        return not node.value
    return isinstance(node, ast.List | ast.Tuple) and not node.elts


def _left(node: ast.stmt) -> Iterator[_Change]:
    if isinstance(node, ast.Raise) and ast.unparse(node) == "raise AssertionError":
        return  # nothing comes there
    yield f"{type(node).__name__.lower()} removed", "pass"


_OPERATORS: dict[type[ast.AST], Callable[..., Iterator[_Change]]] = {
    ast.Compare: _compared,
    ast.BoolOp: _joined,
    ast.UnaryOp: _negated,
    ast.BinOp: _calculated,
    ast.Constant: _constant,
    ast.Call: _called,
    ast.If: _decided,
    ast.While: _decided,
    ast.IfExp: _decided,
    ast.Expr: _done,
    ast.Assign: _assigned,
    ast.AugAssign: _assigned,
    ast.Return: _returned,
    ast.Raise: _left,
    ast.Continue: _left,
    ast.Break: _left,
    ast.Delete: _left,
}


def mutants(path: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file, from its first line to its last."""
    for node, statement, names in _nodes(ast.parse(path.read_text()), None, frozenset()):
        for operator, text in _OPERATORS[type(node)](node):
            replaced = node.test if isinstance(node, ast.If | ast.While | ast.IfExp) else node
            lines = statement.lineno, _end_of_head(statement)
            yield Mutant(path, lines, names, replaced, operator, text)


def _nodes(
    node: ast.AST, statement: ast.stmt | None, names: frozenset[str]
) -> Iterator[tuple[ast.AST, ast.stmt, frozenset[str]]]:
    """Yield the nodes that an operator knows, each with its statement and what this defines."""
    for child in _children(node):
        inside = child if isinstance(child, ast.stmt) else statement
        defined = names
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            defined = frozenset()
        elif isinstance(node, ast.Module | ast.ClassDef):
            defined = _defined(child)
        if inside is not None and type(child) in _OPERATORS:
            yield child, inside, defined
        yield from _nodes(child, inside, defined)


def _defined(statement: ast.AST) -> frozenset[str]:
    targets: list[ast.expr] = []
    if isinstance(statement, ast.Assign):
        targets = statement.targets
    elif isinstance(statement, ast.AnnAssign | ast.AugAssign):
        targets = [statement.target]
    return frozenset(
        inner.id for target in targets for inner in ast.walk(target) if isinstance(inner, ast.Name)
    )


def _is_declared(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    """Return True if a function is for type checkers only, such as an overload."""
    return all(
        isinstance(entry, ast.Expr) and isinstance(entry.value, ast.Constant) for entry in node.body
    )


def _children(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what may be changed within a node."""
    match node:
        case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
            if name not in _PRINTED and not _is_declared(node):
                arguments = node.args
                yield from arguments.defaults
                yield from (item for item in arguments.kw_defaults if item is not None)
                yield from node.body
        case ast.ClassDef():
            yield from node.body
        case ast.AnnAssign(target=ast.Name(id=name)) if name in _TUNING:
            return
        case ast.AnnAssign():
            if node.value is not None and not isinstance(node.target, ast.Subscript):
                yield node.value
        case ast.Raise() | ast.JoinedStr() | ast.Assert():
            # What is raised is known by its type; texts are free. Places in f-strings are wrong
            # before Python 3.12.
            return
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return
        case ast.keyword(arg=str(keyword)) if keyword in _FREE:
            return
        case ast.Assign(targets=[ast.Name(id=name)]) if (
            name.startswith("__") or name in _LEFT_ALONE
        ):
            return
        case ast.Assign(targets=[ast.Tuple(elts=names)], value=ast.Tuple(elts=values)) if (
            _TUNING & _defined(node)
        ):
            for target, value in zip(names, values, strict=True):
                if not (isinstance(target, ast.Name) and target.id in _TUNING):
                    yield value
        case ast.Call(func=function) if _is_log(function):
            return
        case ast.Expr(value=ast.Call(func=function)) if _is_log(function):
            return
        case _:
            yield from (
                child
                for child in ast.iter_child_nodes(node)
                if not (isinstance(child, ast.Expr) and _is_noise(child))
            )


def _is_log(function: ast.expr) -> bool:
    if isinstance(function, ast.Name):
        return function.id == "warn"
    return (
        isinstance(function, ast.Attribute)
        and isinstance(function.value, ast.Name)
        and function.value.id in _LOGS
    )


def _is_noise(statement: ast.Expr) -> bool:
    """Return True if a statement is a docstring, `...` or a line of a log."""
    value = statement.value
    return isinstance(value, ast.Constant) or (isinstance(value, ast.Call) and _is_log(value.func))


def _end_of_head(statement: ast.stmt) -> int:
    body = getattr(statement, "body", None)
    if isinstance(body, list) and body:
        return max(statement.lineno, body[0].lineno - 1)
    return statement.end_lineno or statement.lineno


def _replaced(lines: list[bytes], node: ast.AST, text: str) -> str:
    """Return the source with another text in the place of a node, on as many lines."""
    assert isinstance(node, ast.expr | ast.stmt)
    assert node.end_lineno is not None
    first, last = node.lineno - 1, node.end_lineno - 1
    head = lines[first][: node.col_offset]
    tail = lines[last][node.end_col_offset :]
    filling = b"\n" * (last - first)
    if isinstance(node, ast.stmt):
        inside, tail = text.encode(), tail + filling
    else:
        inside = b"(" + text.encode() + filling + b")"
    return b"".join([*lines[:first], head, inside, tail, *lines[last + 1 :]]).decode()


def _text(node: ast.expr) -> str:
    return ast.unparse(ast.fix_missing_locations(node))


def _short(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= 70 else line[:67] + "..."
