"""
The documents of the repository, cut into what of them is run.

Fences of Python and shell run, with no names but those of blocks before them; one below "`NAME`:"
is a file, which the rest of its document finds; ``<!-- not run: REASON -->`` above a fence says why
it is neither. The other fences are pictures, for whoever reads.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from sybil import Document, Example, Region, Sybil
from sybil.parsers.markdown.lexers import DirectiveInHTMLCommentLexer, RawFencedCodeBlockLexer

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
DOCUMENTS = [path for path in PAGES if "Generated from" not in path.read_text()[:300]]
"""The pages that people write."""

RUN = {"python", "console", "sh"}

_INFO = re.compile(r"(?P<language>\w*)[^\n]*\n")
_FILE = re.compile(r"(?m)^`([\w.]+)`:\n\n\Z")
_NOT_RUN = re.compile(r"<!-- not run: (.+?) -->\s*\Z")

Evaluate = Callable[[Example], None]


@dataclass(frozen=True)
class Examples:
    """The functions that run examples: one for each language of a fence, and one for files."""

    python: Evaluate
    console: Evaluate
    sh: Evaluate
    file: Evaluate

    def __call__(self, document: Document) -> Iterator[Region]:
        """Find the examples, as a parser of Sybil."""
        for region in blocks(document):
            file, language = region.lexemes.get("file"), region.lexemes["language"]
            if not_run(document, region) or not (file or language in RUN):
                continue
            region.parsed = region.lexemes["source"]
            region.evaluator = self.file if file else getattr(self, language)
            yield region


def read(path: Path, examples: Examples) -> Document:
    return Sybil([examples]).parse(path)


def blocks(document: Document) -> Iterator[Region]:
    """Every fence, and what readers do not see: ``<!--- invisible-code-block: python``."""
    for region in RawFencedCodeBlockLexer(_INFO)(document):
        if name := _FILE.search(document.text, 0, region.start):
            region.lexemes["file"] = name[1]
        yield region
    hidden = {"arguments": "language", "source": "source"}
    yield from DirectiveInHTMLCommentLexer("invisible-code-block", "python", hidden)(document)


def not_run(document: Document, region: Region) -> str:
    """Say why a block is not run, or nothing."""
    match = _NOT_RUN.search(document.text, 0, region.start)
    return match[1] if match else ""
