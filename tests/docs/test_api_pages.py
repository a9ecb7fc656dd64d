"""
The parts of the pages of the API begin with what a program constructs or calls.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.documents import ROOT

PAGES = sorted((ROOT / "docs" / "api").glob("*.md"))

RECEIVED = re.compile(
    r"Statistics$|Error$|^(Access|AuditEvent|Asked|Caller|Extent|FleetFile|Found|HistoricalValue"
    r"|Listener|NamedValue|NoValue|Reading|Running|Scan|Search|Summary|Transaction|ValueChange)$"
)
"""What a program gets from calls and hooks, and does not make."""


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_what_is_received_comes_after_what_is_made(path: Path) -> None:
    if path.stem == "errors":
        return
    for part in path.read_text().split("\n## "):
        names = [name.rpartition(".")[2] for name in re.findall(r"(?m)^::: (\S+)$", part)]
        received = [bool(RECEIVED.search(name)) for name in names]
        assert received == sorted(received), names


def test_no_page_shows_a_private_name() -> None:
    for path in PAGES:
        assert not re.search(r"(?m)^::: \S*\._", path.read_text()), path
