"""
Long outputs that are compared with files: `tests/FOLDER/golden/NAME`.

`./run test --make-golden tests/cli` writes the files again; `git diff` then shows what has changed.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

__all__ = ["golden", "pytest_addoption"]

Golden = Callable[[str, str], None]


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--make-golden", action="store_true", help="write the golden files again")


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Golden:
    """Return a function that compares a text with a golden file of the test's folder."""
    folder = request.path.parent / "golden"
    is_made = request.config.getoption("--make-golden")

    def compare(name: str, text: str) -> None:
        path: Path = folder / name
        if is_made:
            folder.mkdir(exist_ok=True)
            path.write_text(text)
        assert text == path.read_text(), f"{path}: --make-golden writes it again"

    return compare
