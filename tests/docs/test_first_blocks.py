"""
The first block of each page that shows how to do something runs as typed, in an empty folder.

It gets no names, files or servers but its own, the files before it, and the examples.
"""

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from sybil import Document, Region

from tests.docs.conftest import Isolated
from tests.docs.documents import ROOT, RUN, blocks, not_run
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
def test_the_first_block_of_a_page_runs_as_typed(
    path: Path, tmp_path: Path, isolated: Isolated
) -> None:
    files, block = first(path)
    source = block.lexemes["source"]
    for text in (source, *(file.lexemes["source"] for file in files)):
        assert [entry for entry in FOREIGN if entry in text] == []
    sources = {file.lexemes["file"]: str(file.lexemes["source"]) for file in files}
    isolated(run_block, sources, block.lexemes["language"], str(source), tmp_path)


def run_block(files: dict[str, str], language: str, source: str, folder: Path) -> None:
    (folder / "examples").symlink_to(ROOT / "examples")
    for name, text in files.items():
        (folder / name).write_text(text)
    if language == "python":
        (folder / "typed.py").write_text(source)
        result = subprocess.run(
            [sys.executable, "-W", "error", "typed.py"],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            timeout=LONGEST_S,
            check=False,
        )
        assert (result.returncode, result.stderr) == (0, ""), result.stderr
        return
    commands = of_console if language == "console" else of_sh
    with closing(Shell(folder, lambda text: text.replace(str(folder), "."))) as shell:
        for command in commands(source):
            shell.type(command)
