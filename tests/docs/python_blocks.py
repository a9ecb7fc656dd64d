"""
Blocks of Python, in which comments are compared with what they stand behind.

==================================  ============================================================
comment                             compared
==================================  ============================================================
``value  # [555, 0, 100]``          a Python value, also of classes: with the value of the line
``name = value  # 2.5``             the same
``value  # Statistics(ok=3, ...)``  with ``...``: what the value looks like
``print(value)  # unit 17: ...``    whatever it says: what is printed
anything else                       is for readers
==================================  ============================================================
"""

import ast
import io
import re
import tokenize
from collections.abc import Callable

from sybil import Example


def run_python(example: Example, source: str, normalize: Callable[[str], str]) -> None:
    """
    Run a block in the namespace of its document. `source`: the block, with the addresses of this
    machine; `seen`: puts the addresses of the document into what was printed.
    """
    tree = Comparing(source).visit(ast.parse(source))
    ast.increment_lineno(tree, example.line)
    code = compile(tree, example.path, "exec")
    example.namespace |= {"must_equal": must_equal, "must_print": must_print(normalize)}
    exec(code, example.namespace)


class Comparing(ast.NodeTransformer):
    """Turns ``asked()  # [1]`` into a comparison."""

    def __init__(self, source: str) -> None:
        self._comments = comments_of(source)
        self.compared = 0

    def visit_Expr(self, node: ast.Expr) -> ast.stmt:
        comment = self._comments.get(node.end_lineno or 0)
        if comment is None:
            return node
        if isinstance(node.value, ast.Call) and is_print(node.value):
            return self._compare(node, ast.Name("must_print"), comment, node.value.args)
        if is_value(comment):
            return self._compare(node, ast.Name("must_equal"), comment, [node.value])
        return node

    def visit_Assign(self, node: ast.Assign) -> list[ast.stmt]:
        """Look at the name after it was assigned."""
        name = node.targets[0]
        if not isinstance(name, ast.Name):
            return [node]
        look = ast.copy_location(ast.Expr(ast.Name(name.id, ast.Load())), node)
        return [node, self.visit_Expr(ast.fix_missing_locations(look))]

    def _compare(
        self, node: ast.stmt, function: ast.Name, comment: str, arguments: list[ast.expr]
    ) -> ast.stmt:
        self.compared += 1
        function.ctx = ast.Load()
        value: ast.expr = ast.Constant(comment)
        if function.id == "must_equal" and "..." not in comment:
            value = ast.parse(comment, mode="eval").body
        statement = ast.Expr(ast.Call(function, [value, *arguments], []))
        return ast.fix_missing_locations(ast.copy_location(statement, node))


def comments_of(source: str) -> dict[int, str]:
    """Return the comments that stand behind something, by line."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return {
        token.start[0]: token.string.lstrip("# ")
        for token in tokens
        if token.type == tokenize.COMMENT and token.line[: token.start[1]].strip()
    }


def is_print(call: ast.Call) -> bool:
    return isinstance(call.func, ast.Name) and call.func.id == "print"


def is_value(comment: str) -> bool:
    """Return True if a comment is a value that was written out, and not a word or a sentence."""
    try:
        body = ast.parse(comment, mode="eval").body
    except SyntaxError:
        return "..." in comment and re.match(r"[\[({]|[A-Z]\w*\(", comment) is not None
    names = [node.id for node in ast.walk(body) if isinstance(node, ast.Name)]
    return not isinstance(body, ast.Name) and all(name[0].isupper() for name in names)


def must_equal(comment: object, value: object) -> None:
    if isinstance(comment, str) and "..." in comment:
        text = repr(value).replace("'", '"')
        assert matches(comment.replace("'", '"'), text), f"{text} is not {comment}"
    else:
        assert value == comment, f"{value!r} is not {comment!r}"


def must_print(normalize: Callable[[str], str]) -> Callable[..., None]:
    def compare(comment: str, *values: object) -> None:
        printed = normalize(" ".join(map(str, values)))
        assert matches(normalize(comment), printed), f"printed is {printed!r}, not {comment!r}"

    return compare


def matches(pattern: str, text: str) -> bool:
    """Compare texts: ``...`` is anything, and blanks are as long as they like."""
    parts = [_flexible(part) for part in pattern.split("...")]
    return re.fullmatch(".*?".join(parts), text, re.DOTALL) is not None


def _flexible(text: str) -> str:
    return "[ \t]+".join(map(re.escape, re.split("[ \t]+", text)))
