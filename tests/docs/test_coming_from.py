"""
The pages for who comes from a peer: pairs of snippets, which give the same.

That both sides run, and give what they say, is seen where all documents run.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from sybil import Document

from libmodbus_py import ModbusError, errors
from tests.docs.documents import ROOT, blocks
from tests.docs.python_blocks import comments_of, is_value

OTHERS = ("mbpoll",)
"""Pages without pairs: tables of options."""

FLAGS = re.IGNORECASE | re.DOTALL

PAGES = sorted(
    path for path in (ROOT / "docs" / "coming-from").glob("*.md") if path.stem not in OTHERS
)
PAIR = '<div class="grid" markdown>'


def pairs(path: Path) -> Iterator[list[str]]:
    for part in path.read_text().split(PAIR)[1:]:
        document = Document(part.partition("</div>")[0], str(path))
        yield [region.lexemes["source"] for region in blocks(document)]


def said(source: str) -> list[object]:
    """The values that comments name; a value alone and a list of it are one to readers."""
    values = [text for text in comments_of(source).values() if is_value(text)]
    found = [ast.literal_eval(text) for text in values]
    return [each[0] if isinstance(each, list) and len(each) == 1 else each for each in found]


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_both_sides_of_the_pairs_give_the_same(path: Path) -> None:
    found = list(pairs(path))
    assert len(found) >= 8
    for theirs, ours in found:
        assert said(theirs)[-1] == said(ours)[-1], ours
        assert "libmodbus_py" not in theirs


@pytest.mark.parametrize("path", sorted((ROOT / "docs/coming-from").glob("*.md")))
def test_each_page_names_the_kinds_of_errors(path: Path) -> None:
    direct = [name for name in errors.__all__ if ModbusError in getattr(errors, name).__bases__]
    kinds = {*direct, "ModbusError"}
    (text,) = re.findall(r"every error is a `ModbusError`.*?errors\.md\)", path.read_text(), FLAGS)
    assert kinds | {"IllegalDataAddress"} == set(re.findall(r"`(\w+)`", text))
