"""
Test the lowest versions that pyproject.toml allows of what the package itself uses.

    ./run python packaging/lowest.py [pytest arguments]

They are installed into .venv-lowest, as constraints of pip: `name==version` for each
`name>=version`. What only tests and tools use is left free. Without arguments, the tests of what
uses an optional dependency run. The Debian packages must be there: `./run test` installs them.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / ".venv-lowest"
PYTHON = str(FOLDER / "bin" / "python")
EXTRAS = ("security", "metrics", "homeassistant", "mqtt", "completion", "nats", "sunspec")
TESTS = (
    "tests/test_package.py",
    "tests/security",
    "tests/services/integrations",
    "tests/cli/test_completion.py",
    "tests/services/fleet/outputs/test_fleet_mqtt.py",
    "tests/services/engine/test_connection.py",
    "tests/services/workers/test_engine_face.py",
    "tests/tools/sunspec",
)

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


def install() -> None:
    """
    Make .venv-lowest, and install the package and what its tests need into it.

    Raises:
        CalledProcessError: venv or pip failed, and said why.
    """
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    file = ROOT / "build" / "lowest.txt"
    file.parent.mkdir(exist_ok=True)
    file.write_text("".join(f"{line}\n" for line in constraints(project)))
    subprocess.run([sys.executable, "-m", "venv", FOLDER], check=True)
    pip = [PYTHON, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, "-c", file, "-e", f"{ROOT}[test]"], check=True)


if __name__ == "__main__":
    install()
    os.chdir(ROOT)
    os.execv(PYTHON, [PYTHON, "-m", "pytest", "-n", "auto", *(sys.argv[1:] or TESTS)])
