"""
The first block of each page that shows how to do something runs as typed, in an empty folder.

It gets no names, files or servers but its own, the files before it, and the examples. Only the
addresses of this machine are replaced, because two processes cannot have the same port.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from sybil import Document, Region

from tests.docs.documents import ROOT, RUN, blocks, not_run
from tests.docs.home import own_address
from tests.docs.shell_blocks import Shell, of_console, of_sh

PAGES = [
    ROOT / "README.md",
    ROOT / "docs" / "index.md",
    *sorted((ROOT / "docs/how-to").glob("*.md")),
]

FOREIGN = ("192.0.2.", "/dev/tty", ".example")
"""What no empty folder has: devices, ports and hosts of others."""

LONGEST_S = 60.0


def first(path: Path) -> tuple[list[Region], Region]:
    """Return the first block that runs, and the files before it."""
    document = Document(path.read_text(), str(path))
    files = []
    for region in blocks(document):
        if not_run(document, region):
            continue
        if region.lexemes.get("file"):
            files.append(region)
        elif region.lexemes["language"] in RUN:
            return files, region
    raise AssertionError(f"{path} has no block that runs")


@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_first_block_of_a_page_runs_as_typed(path: Path, tmp_path: Path) -> None:
    files, block = first(path)
    source = block.lexemes["source"]
    for text in (source, *(each.lexemes["source"] for each in files)):
        assert [each for each in FOREIGN if each in text] == []
    address = own_address()
    (tmp_path / "examples").symlink_to(ROOT / "examples")

    def here(text: str) -> str:
        text = text.replace("certificates certs", f"certificates --host {address} certs")
        return text.replace("127.0.0.1", address)

    def there(text: str) -> str:
        return text.replace(address, "127.0.0.1").replace(str(tmp_path), ".")

    for each in files:
        (tmp_path / each.lexemes["file"]).write_text(here(each.lexemes["source"]))
    if block.lexemes["language"] == "python":
        (tmp_path / "typed.py").write_text(here(source))
        result = subprocess.run(
            [sys.executable, "-W", "error", "typed.py"],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
            check=False,
        )
        assert (result.returncode, result.stderr) == (0, "")
        return
    shell = Shell(tmp_path, here, there)
    commands = of_console if block.lexemes["language"] == "console" else of_sh
    try:
        for command in commands(source):
            shell.type(command)
    finally:
        shell.close()
