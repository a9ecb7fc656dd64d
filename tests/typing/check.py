"""
What type checkers say to programs that use the package: python tests/typing/check.py

mypy --strict and pyright must take every line of right.py and loop.py, must refuse every line of
wrong.py that is marked so, and pyright must know the types of what the package exports.
Part of ./run lint; it ends with 1 and says where a checker disagrees.
"""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parent.parent
FILES = ("right.py", "loop.py", "wrong.py")
# Percent of the exported names whose types pyright knows without guessing.
COMPLETE = 99.0

# A file's name and the number of a line.
Place = tuple[str, int]


def main() -> int:
    results = {"mypy": mypy(), "pyright": pyright()}
    complaints = [disagreement for item in results.items() for disagreement in disagreements(*item)]
    share = completeness()
    if share < COMPLETE:
        complaints.append(f"pyright knows {share:.1f} % of the types, {COMPLETE:g} % are wanted")
        complaints.append(f"  {' '.join(VERIFY)} says which it does not")
    print("\n".join(complaints) or f"The typed face holds; {share:.1f} % of it has a type.")
    return bool(complaints)


# --- what the files want -------------------------------------------------------------------


def marked() -> set[Place]:
    return {
        (name, number)
        for name in FILES
        for number, line in enumerate((HERE / name).read_text().splitlines(), 1)
        if line.endswith("# wrong")
    }


def disagreements(checker: str, errors: dict[Place, str]) -> list[str]:
    """Say where a checker is silent that must speak, or the other way round."""
    wrong = marked()
    complaints = [
        f"{place[0]}:{place[1]}: {checker} complains: {errors[place]}"
        for place in sorted(errors.keys() - wrong)
    ]
    silent = [
        f"{place[0]}:{place[1]}: {checker} takes what is wrong"
        for place in sorted(wrong - errors.keys())
    ]
    return complaints + silent


# --- what the checkers say -----------------------------------------------------------------


def mypy() -> dict[Place, str]:
    text = output([tool("mypy"), "--strict", "--no-error-summary", *paths()])
    errors = re.findall(r"^(?:.*/)?(\w+\.py):(\d+): error: (.*)$", text, re.MULTILINE)
    return {(name, int(line)): message for name, line, message in errors}


def pyright() -> dict[Place, str]:
    report = json.loads(output([tool("pyright"), "--outputjson", *paths()]))
    return {
        (Path(row["file"]).name, row["range"]["start"]["line"] + 1): row["message"]
        for row in report["generalDiagnostics"]
        if row["severity"] == "error"
    }


def completeness() -> float:
    report: dict[str, Any] = json.loads(output([tool("pyright"), "--outputjson", *VERIFY[1:]]))
    return 100 * float(report["typeCompleteness"]["completenessScore"])


VERIFY = ["pyright", "--verifytypes", "libmodbus_py", "--ignoreexternal"]


def tool(name: str) -> str:
    return str(Path(sys.executable).parent / name)


def paths() -> list[str]:
    return [str(HERE / name) for name in FILES]


def output(command: list[str]) -> str:
    # An editable installation is found by a hook that pyright does not run: it is told
    # the path instead. And it need not ask the network for a newer version of itself.
    surroundings = {"PYTHONPATH": str(ROOT), "PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    # meter.py, which `libmodbus-py map class` has written, is beside the files that use it.
    surroundings["MYPYPATH"] = f"{ROOT}:{HERE}"
    process = subprocess.run(
        command,
        cwd=ROOT,
        env=os.environ | surroundings,
        capture_output=True,
        text=True,
        check=False,
    )
    if process.returncode not in (0, 1):
        raise SystemExit(f"{' '.join(command)}:\n{process.stdout}{process.stderr}")
    return process.stdout


if __name__ == "__main__":
    sys.exit(main())
