"""
Check what a release needs, before anything is published: python packaging/release.py TAG

A tag is "v" and the version, which stands in three files; and the address of the repository, which
cannot be added to a version that an index has, stands in pyproject.toml.
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]

VERSIONS = {
    "pyproject.toml": r'^version = "(.+)"$',
    "libmodbus_py/version.py": r'^__version__ = "(.+)"$',
    "packaging/debian/changelog": r"\Alibmodbus-py \((.+)-\d+\)",
}
"""Files with the version -> where it stands in them."""


def check(tag: str, root: Path = ROOT) -> None:
    """
    Raise for a tag that must not be published.

    Raises:
        SystemExit: it is not that of the version in a file, or there is no public address.
    """
    for name, pattern in VERSIONS.items():
        (version,) = re.findall(pattern, (root / name).read_text(), re.MULTILINE)
        if tag != f"v{version}":
            raise SystemExit(f"release: the tag is {tag}, but the version in {name} is {version}")
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    if not project.get("urls", {}).get("Source"):
        raise SystemExit("release: pyproject.toml has no [project.urls] Source, a public address")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    check(sys.argv[1])
