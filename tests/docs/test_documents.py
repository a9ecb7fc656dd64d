"""What README.md and docs say runs, and gives what it says it does."""

import ast
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from sybil import Document, Region

from tests.docs.conftest import Isolated
from tests.docs.documents import DOCUMENTS, PAGES, ROOT, blocks, not_run
from tests.docs.home import run_document
from tests.docs.python_blocks import Comparing
from tests.support.cases import each_case

NAMES = [str(path.relative_to(ROOT)) for path in DOCUMENTS]


@pytest.mark.parametrize("path", DOCUMENTS, ids=NAMES)
def test_the_examples_of_a_document_run(path: Path, tmp_path: Path, isolated: Isolated) -> None:
    isolated(run_document, path, tmp_path)


def everything() -> Iterator[tuple[Document, Region]]:
    for path in DOCUMENTS:
        document = Document(path.read_text(), str(path))
        for region in blocks(document):
            yield document, region


def test_comments_and_outputs_are_compared() -> None:
    """Else the test above would prove less than it says."""
    compared = 0
    for document, region in everything():
        source = region.lexemes["source"]
        if region.lexemes["language"] == "python" and not not_run(document, region):
            comparing = Comparing(source)
            comparing.visit(ast.parse(source))
            compared += comparing.compared
    assert compared >= 70


def test_readers_see_where_each_name_comes_from() -> None:
    """Only blocks that readers do not see use what the tests put into the namespace."""
    places = [
        f"{document.path}: {region.lexemes['source']}"
        for document, region in everything()
        if document.text[region.start : region.start + 3] == "```"
        if re.search(r"\bhome\.", region.lexemes["source"])
    ]
    assert places == []


REASONS = (
    "installs packages",
    "needs a program that may be missing",
    "needs a real serial port",
    "takes long",
    "this repository's own commands",
)


def test_blocks_that_are_not_run_name_the_reason() -> None:
    reasons = [not_run(document, region) for document, region in everything()]
    assert [reason for reason in reasons if reason and not reason.startswith(REASONS)] == []
    assert len([reason for reason in reasons if reason]) <= 20


def in_nav(entry: object) -> Iterator[str]:
    """Return the pages below an entry of the navigation."""
    if isinstance(entry, str):
        yield entry
    for below in entry if isinstance(entry, list) else getattr(entry, "values", list)():
        yield from in_nav(below)


def test_every_page_is_in_the_navigation() -> None:
    """A page that is not there is missing, too: Zensical says nothing of either."""
    project = tomllib.loads((ROOT / "zensical.toml").read_text())["project"]
    pages = [str(path.relative_to(ROOT / "docs")) for path in PAGES[1:]]
    assert sorted(in_nav(project["nav"])) == pages


EXTRAS = re.compile(r"(?:libmodbus-py|'\.)\[([\w,]+)\]")
"""What pip installs: the package or its folder, and extras."""


@each_case("path", DOCUMENTS, ids=NAMES)
def test_extras_that_documents_name_exist(path: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = {extra for names in EXTRAS.findall(path.read_text()) for extra in names.split(",")}
    assert extras <= project["optional-dependencies"].keys()


def test_the_first_screen_of_the_readme() -> None:
    """What it is, how to install it, fifteen lines, the commands of a clone, a table, a picture."""
    text = (ROOT / "README.md").read_text()
    assert text.split("\n\n")[1].count(".") == 1
    parts = ("pip install", "```python\n", "./run demo", "\n| |", "\n![", "\n* [Start here]")
    order = [text.index(part) for part in parts]
    assert order == sorted(order)
    program = text.partition("```python\n")[2].partition("\n```")[0]
    assert len([line for line in program.splitlines() if line]) <= 15


@each_case("path", DOCUMENTS, ids=NAMES)
def test_names_of_files_stand_above_their_blocks(path: Path) -> None:
    """A forge does not show the title of a fence."""
    assert re.findall(r"(?m)^```\w* .+$", path.read_text()) == []


def headings(path: Path) -> set[str]:
    return {
        re.sub(r"[^\w\- ]", "", line.lstrip("# ").lower()).replace(" ", "-")
        for line in path.read_text().splitlines()
        if line.startswith("#")
    }


LINK = re.compile(r"""\]\(([^)\s]*)\)|^\[[^]]+\]:\s*(\S+)|(?:src|href)="([^"]*)\"""", re.MULTILINE)


def links_of(text: str) -> list[str]:
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    return ["".join(parts) for parts in LINK.findall(prose)]


@each_case("path", PAGES)
def test_links_lead_to_files_and_headings_that_exist(path: Path) -> None:
    for link in links_of(path.read_text()):
        if re.match(r"\w+:", link):
            continue
        target, _, heading = link.partition("#")
        file = path.parent / target if target else path
        assert file.exists(), link
        if heading and file.suffix == ".md":
            assert heading in headings(file), link
