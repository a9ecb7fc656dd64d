"""The table of messages of the log: each message of the package with its level, and no other."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import libmodbus_py

SOURCES = Path(libmodbus_py.__file__).parent
PAGE = (Path(__file__).parents[2] / "docs" / "log.md").read_text()

LEVELS = {"info": "info", "warning": "warning", "error": "error", "exception": "error"}

ROW = re.compile(r"^`(.+?)` \| (?:\*(info|error)\*: )?(.+)$", re.MULTILINE)

PLACE = re.compile(r"%[sdgr]|%\.\d[fg]")


def text_of(argument: ast.expr, before: dict[str, str]) -> str:
    """Return a message whose parts are constants, or names of constants; otherwise nothing."""
    if isinstance(argument, ast.Constant):
        return str(argument.value)
    if isinstance(argument, ast.BinOp):
        return text_of(argument.left, before) + text_of(argument.right, before)
    return before.get(argument.id, "") if isinstance(argument, ast.Name) else ""


def messages(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield the messages of the calls of loggers in a file, and their levels."""
    texts: dict[str, str] = {}
    for node in sorted(ast.walk(tree), key=lambda node: getattr(node, "lineno", 0)):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            texts[node.targets[0].id] = text_of(node.value, texts)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            owner = ast.unparse(node.func.value).lower()
            level = LEVELS.get(node.func.attr) if "log" in owner else None
            if level and node.args and (text := text_of(node.args[0], texts)):
                yield PLACE.sub("…", text), level


def test_the_table_has_each_message_with_its_level() -> None:
    coded: dict[str, str] = {}
    sources = ""
    for path in SOURCES.rglob("*.py"):
        source = path.read_text()
        sources += source
        coded |= {text: level for text, level in messages(ast.parse(source)) if text.strip("…: ")}
    rows = {text: level or "warning" for text, level, _ in ROW.findall(PAGE)}
    assert {text: level for text, level in coded.items() if rows.get(text) != level} == {}
    # The other messages are put together, such as the line about files that were read again.
    for text in rows.keys() - coded.keys():
        assert max(text.split("…"), key=len).strip() in sources, text


def test_no_message_is_in_the_table_twice() -> None:
    texts = [row[0] for row in ROW.findall(PAGE)]
    assert len(texts) == len(set(texts)) > 0
