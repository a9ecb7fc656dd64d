"""
Build the documentation: python packaging/docs SITE

The pages are those of docs/, with links that lead out of it made absolute or copied (links);
zensical builds them; then the copy buttons (copying) and the search (searching) are set up. Any
warning is an error.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import copying
import links
import searching

ROOT = Path(__file__).parents[2]
PREPARED = ROOT / "build" / "docs"
# Beside zensical.toml, because paths in it begin there.
CONFIG = ROOT / "build-docs.toml"


def build(site: Path) -> None:
    """
    Build the documentation into a folder.

    Raises:
        SystemExit: zensical, or a check of what it built, found a mistake.
    """
    repository = links.repository(ROOT)
    shutil.rmtree(PREPARED, ignore_errors=True)
    shutil.copytree(ROOT / "docs", PREPARED, ignore=shutil.ignore_patterns("*.txt"))
    for path in sorted(PREPARED.rglob("*.md")):
        page = path.relative_to(PREPARED)
        path.write_text(links.prepared(path.read_text(), page, ROOT, PREPARED, repository))
    text = (ROOT / "zensical.toml").read_text()
    places = [f'docs_dir = "{PREPARED.relative_to(ROOT)}"', f'site_dir = "{site}"']
    places += [f'repo_url = "{repository}"'] if repository else []
    CONFIG.write_text(
        re.sub(r"(?m)^\[project\]$", "\n".join(["[project]", *places]), text, count=1)
    )
    try:
        command = ["zensical", "build", "--clean", "--strict", "-f", str(CONFIG)]
        if subprocess.run([sys.executable, "-m", *command], check=False).returncode:
            raise SystemExit(1)
    finally:
        CONFIG.unlink()
    for page in site.rglob("*.html"):
        page.write_text(copying.with_commands(page.read_text()))
    asked = tomllib.loads((ROOT / "packaging" / "docs" / "asked.toml").read_text())
    index = site / "search.json"
    index.write_text(searching.arranged(index.read_text(), asked))
    if mistakes := searching.mistakes(index.read_text(), asked, site):
        raise SystemExit("\n".join(mistakes))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    build(Path(sys.argv[1]).resolve())
