"""
Long outputs that are compared with files: `tests/FOLDER/golden/NAME`.

`./run test --make-golden tests/cli` writes the files again; `git diff` then shows what has changed.
"""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Golden = Callable[[str, str], None]
Refused = Callable[[str, Callable[[Any], object]], None]


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


@pytest.fixture
def refused(request: pytest.FixtureRequest, golden: Golden) -> Refused:
    """
    Return a function that compares a golden file of mistakes with what is said of them.

    For each mistake the file has what is given, an expression of Python, with the message in the
    next line; then an empty line. The function takes the name of the file, and what takes what is
    given and raises a ValueError, or a TypeError, of one line.
    """

    def compare(name: str, call: Callable[[Any], object]) -> None:
        lines = []
        for text in (request.path.parent / "golden" / name).read_text().split("\n")[::3]:
            with pytest.raises((TypeError, ValueError)) as caught:
                call(eval(text, {"math": math}))
            kind = "TypeError: " if isinstance(caught.value, TypeError) else ""
            message = f"{kind}{caught.value}"
            assert message.isprintable()
            assert len(message) < 1000
            lines += [text, f"    {message}", ""]
        golden(name, "\n".join(lines))

    return compare
