"""
Test the lowest versions that pyproject.toml allows of what the package itself uses.

    ./run python packaging/lowest.py [pytest arguments]

They are installed into .venv-lowest, as constraints of pip: `name==version` for the highest
`name>=version` that holds for this Python. What only tests and tools use is left free. Without
arguments, the tests of what uses an optional dependency run. The Debian packages must be there:
`./run test` installs them.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.version import Version

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


def constraints(project: dict[str, Any]) -> list[str]:
    """
    Return a line for each package that this Python wants.

    Raises:
        ValueError: a package has no lowest version.
    """
    wanted = [*project["dependencies"]]
    for extra in EXTRAS:
        wanted += project["optional-dependencies"][extra]
    lowest: dict[str, list[Version]] = {}
    for entry in map(Requirement, wanted):
        if entry.marker is None or entry.marker.evaluate():
            found = [Version(part.version) for part in entry.specifier if part.operator == ">="]
            lowest.setdefault(entry.name, []).extend(found)
    for name, versions in lowest.items():
        if not versions:
            raise ValueError(f"{name!r} has no lowest version")
    return [f"{name}=={max(versions)}" for name, versions in lowest.items()]


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
