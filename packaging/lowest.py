"""
The lowest versions that pyproject.toml allows of what the package itself uses, as constraints of
pip: `name==version` for each `name>=version`. What only tests and tools use is left free.
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
EXTRAS = ("security", "metrics", "homeassistant", "mqtt", "completion", "nats", "sunspec")

# The name, the lowest version, and the environment that wants it.
_LOWEST = re.compile(r"([\w.-]+)(?:\[[^]]*\])?>=([\w.]+)[^;]*(;.*)?")


def constraints(project: dict[str, Any]) -> Iterator[str]:
    """
    Return a line for each requirement.

    Raises:
        ValueError: a requirement has no lowest version.
    """
    wanted = [*project["dependencies"]]
    for extra in EXTRAS:
        wanted += project["optional-dependencies"][extra]
    for requirement in wanted:
        found = _LOWEST.fullmatch(requirement)
        if found is None:
            raise ValueError(f"{requirement!r} has no lowest version")
        name, version, marker = found.groups(default="")
        yield f"{name}=={version}{marker}"


def main() -> int:
    project = tomllib.loads(PYPROJECT.read_text())["project"]
    print(*constraints(project), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
