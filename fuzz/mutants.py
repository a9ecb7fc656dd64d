"""
Change single places of a folder of the package, and see whether its tests fail, with mutmut.

    ./run python -m fuzz.mutants FOLDER [--sample N] [--seed S] [--tests FOLDER ...]

N mutants are drawn at random, and tried on the tests in the folder of the same name, or in those
that are named. No file of the work tree changes: all is done in `build/mutants`, where
`mutmut show NAME` prints what survived.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

BUILD = Path("build/mutants")
OPTIONS = {
    "source_paths": ["libmodbus_py"],
    # pytest runs several times in one process, where the plugins of the tests are known already.
    "pytest_add_cli_args": [
        *("-p", "no:cacheprovider", "-p", "no:xdist", "--timeout=60"),
        *("-W", "ignore::pytest.PytestAssertRewriteWarning"),
    ],
    # Texts and what is logged are free; how an object is printed, too.
    "do_not_mutate_patterns": [r"(logger|log|warnings)\.", r"raise \w", r"def __(repr|str)__"],
}


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="fuzz.mutants", description=(__doc__ or "").split("\n")[1]
    )
    parser.add_argument("folder")
    parser.add_argument("--sample", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--tests", nargs="+")
    arguments = parser.parse_args()
    shutil.rmtree(BUILD, ignore_errors=True)
    BUILD.mkdir(parents=True)
    tracked = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout
    names = sorted({name.split("/")[0] for name in tracked.split()} - {"pyproject.toml"})
    for name in names:
        (BUILD / name).symlink_to(Path(name).resolve())
    options = OPTIONS | {
        "only_mutate": [f"libmodbus_py/{arguments.folder}/*"],
        "pytest_add_cli_args_test_selection": arguments.tests or [f"tests/{arguments.folder}"],
        "also_copy": names,
    }
    rows = "".join(f"{name} = {json.dumps(value)}\n" for name, value in options.items())
    text = Path("pyproject.toml").read_text()
    (BUILD / "pyproject.toml").write_text(f"{text}\n[tool.mutmut]\n{rows}")
    command = [sys.executable, "-m", "mutmut", "run"]
    # Makes all mutants, and ends because none has this name.
    subprocess.run([*command, "none"], cwd=BUILD, check=False, stderr=subprocess.DEVNULL)
    mutants = [
        name
        for path in sorted((BUILD / "mutants").rglob("*.meta"))
        for name in json.loads(path.read_text())["exit_code_by_key"]
    ]
    drawn = random.Random(arguments.seed).sample(mutants, min(arguments.sample, len(mutants)))
    sys.exit(subprocess.run([*command, *drawn], cwd=BUILD, check=False).returncode)


if __name__ == "__main__":
    main()
