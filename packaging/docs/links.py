"""
Links of the documentation to files of the repository.

In docs/ and README.md they are relative, so that they work wherever the files are read. A built
page has none of these files beside it: there they lead to the repository if it has a public address
(`Source` in [project.urls] of pyproject.toml, the one place for it), and else to a copy.
"""

from __future__ import annotations

import os
import re
import shutil
import tomllib
from pathlib import Path

LINK = re.compile(r"(?<=\]\()(?!\w+:|#)([^)\s#]+)(#[^)\s]*)?(?=\))")
LABELLED = re.compile(r"\[([^\]]+)\]\(\)")

COPIES = "files"
"""The folder of a built documentation that has copies of files of the repository."""


def repository(root: Path) -> str:
    """Return the public address of the repository, or "" as long as it has none."""
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    address: str = project.get("urls", {}).get("Source", "")
    return address.rstrip("/")


def absolute(text: str, folder: str, root: Path, address: str) -> str:
    """Return Markdown of a file in a folder of the repository, with absolute links to others."""

    def changed(found: re.Match[str]) -> str:
        path = os.path.normpath(os.path.join(folder, found[1]))
        kind = "raw" if path.endswith((".png", ".svg")) else "blob"
        kind = "tree" if (root / path).is_dir() else kind
        return f"{address}/{kind}/main/{path}{found[2] or ''}"

    return LINK.sub(changed, text)


def prepared(text: str, page: Path, root: Path, docs: Path, address: str) -> str:
    """
    Return a page with its links out of docs/ changed, and copy what they lead to.

    Args:
        page: its path below docs/.
        docs: the folder that becomes the site.
        address: of the repository, or "".
    """

    def changed(found: re.Match[str]) -> str:
        path = os.path.normpath(os.path.join("docs", page.parent, found[1]))
        if path.startswith("docs/"):
            return found[0]
        if address:
            kind = "tree" if (root / path).is_dir() else "blob"
            return f"{address}/{kind}/main/{path}"
        if (root / path).is_dir():
            return ""  # its label stays
        name = Path(COPIES, f"{path}.txt" if Path(path).suffix == ".md" else path)
        (docs / name.parent).mkdir(parents=True, exist_ok=True)
        shutil.copy(root / path, docs / name)
        return os.path.relpath(name, page.parent)

    return LABELLED.sub(r"\1", LINK.sub(changed, text))
