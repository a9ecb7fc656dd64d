"""What people type into the search of the documentation leads to a page that answers it."""

import json
import re
import runpy
import tomllib
from pathlib import Path
from typing import Any

from tests.docs.documents import PAGES, ROOT

SCRIPTS = ROOT / "packaging" / "docs"

ASKED: dict[str, str] = tomllib.loads((SCRIPTS / "asked.toml").read_text())

SEARCHING = runpy.run_path(str(SCRIPTS / "searching.py"))


def headings(path: Path) -> dict[str, str]:
    """Return the headings of a page: anchor -> text."""
    text = re.sub(r"(?ms)^```.*?^```$", "", path.read_text())
    heads = re.findall(r"(?m)^#+ (.+)$", text)
    return {re.sub(r"[^a-z0-9_]+", "-", head.lower()).strip("-"): head for head in heads}


def page_of(location: str) -> Path:
    page = location.partition("#")[0].rstrip("/")
    return ROOT / "docs" / (f"{page}.md" if page else "index.md")


def index() -> str:
    """Return an index as the build writes it: names of the API first, which is the worst case."""
    items: list[dict[str, Any]] = []
    for path in PAGES:
        if path.name == "README.md":
            continue
        page = f"{path.relative_to(ROOT / 'docs').with_suffix('')}/"
        for number, (anchor, text) in enumerate(headings(path).items()):
            items.append({"location": f"{page}#{anchor}" if number else page, "title": text})
    names = [{"location": f"api/x/#{words}", "title": words} for words in ASKED]
    return json.dumps({"items": [{"path": [], **entry} for entry in [*names, *items]]})


def test_questions_are_many_and_lead_to_headings_that_exist() -> None:
    assert len(ASKED) >= 50
    for words, location in ASKED.items():
        path = page_of(location)
        assert path.exists(), words
        anchor = location.partition("#")[2]
        assert not anchor or anchor in headings(path), words


def test_each_question_finds_its_page_before_names_of_the_api() -> None:
    arranged = SEARCHING["arranged"](index(), ASKED)
    items = json.loads(arranged)["items"]
    pages = {words: SEARCHING["first"](items, words) for words in ASKED}
    assert pages == ASKED


def test_no_question_leads_to_the_api() -> None:
    assert [words for words, location in ASKED.items() if location.startswith("api/")] == []
