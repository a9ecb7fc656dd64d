"""
The search of the documentation: pages come before names of the API, and common questions lead to
the page that answers them.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

API = "api/"

Item = dict[str, Any]


def arranged(index: str, asked: dict[str, str]) -> str:
    """
    Return the index with an entry for each question, and with names of the API at its end.

    Args:
        index: as the build wrote it.
        asked: what people type -> the page, or the heading in it, that answers it.
    """
    found = json.loads(index)
    items: list[Item] = found["items"]
    places = {item["location"]: item for item in items}
    questions = []
    for words, location in asked.items():
        item = places.get(location)
        if item is not None:
            path = [*item["path"], item["title"]] if "#" in location else item["path"]
            questions.append(item | {"title": words.capitalize(), "level": 1, "path": path})
    items.sort(key=lambda item: item["location"].startswith(API))
    return json.dumps(found | {"items": [*questions, *items]}, ensure_ascii=False)


def mistakes(index: str, asked: dict[str, str], site: Path) -> list[str]:
    """Return what is wrong with an index: questions that lead nowhere, or to the API first."""
    items: list[Item] = json.loads(index)["items"]
    found = []
    for words, location in asked.items():
        page, _, heading = location.partition("#")
        file = site / page / "index.html"
        if not file.exists() or (heading and f'id="{heading}"' not in file.read_text()):
            found.append(f"search: {words!r} leads to {location}, which does not exist")
        elif first(items, words) != location:
            found.append(f"search: {words!r} leads to {first(items, words)}, not to {location}")
    return found


def first(items: list[Item], words: str) -> str:
    """Return the location of the first entry whose title has all words."""
    wanted = set(words.lower().split())
    for item in items:
        if wanted <= set(re.split(r"[\W_]+", item["title"].lower())):
            return str(item["location"])
    return ""
