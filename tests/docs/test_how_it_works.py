"""What the page about the code says is there: files, and named exceptions."""

import re

from fuzz.explore import EXCEPTIONS
from tests.docs.documents import ROOT

PAGE = (ROOT / "docs" / "how-it-works.md").read_text()
TIMING = (ROOT / "docs" / "protocol" / "timing.md").read_text()

FOLDERS = ("", "libmodbus_py", "libmodbus_py/client", "libmodbus_py/server")
"""Where the page names files from."""


def test_every_file_that_is_named_exists() -> None:
    paths = re.findall(r"`([\w/]+(?:\.py|\.c|/))`", PAGE)
    assert len(paths) >= 20
    missing = [
        name for name in paths if not any((ROOT / folder / name).exists() for folder in FOLDERS)
    ]
    assert missing == []


def test_ambiguous_answers_have_the_names_of_the_explorer() -> None:
    part = TIMING.partition("### What cannot be told apart")[2].partition("\n## ")[0]
    names = re.findall(r"^\| ([\w ]+) \|", part, re.MULTILINE)
    assert names[1:] == [*EXCEPTIONS]
