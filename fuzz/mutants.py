"""
Change single places of a folder of the package, and see whether its tests fail, with mutmut.

    ./run python -m fuzz.mutants FOLDER [NUMBER [SEED]]

So many mutants are drawn at random, and tried on the tests in the folder of the same name. No file
of the work tree changes: all is done in `build/mutants`, where `mutmut show NAME` prints what
survived.
"""

from __future__ import annotations

import importlib.util
import json
import random
import shutil
import subprocess
import sys
from pathlib import Path

BUILD = Path("build/mutants")
OPTIONS: dict[str, object] = {
    "source_paths": ["libmodbus_py"],
    "process_isolation": "forkserver",  # which has run no test before it forks
    # pytest runs several times in one process, where the plugins of the tests are known already.
    "pytest_add_cli_args": [
        *("-p", "no:cacheprovider", "-p", "no:xdist", "--timeout=60"),
        *("-W", "ignore::pytest.PytestAssertRewriteWarning"),
    ],
    # Texts and what is logged are free; how an object is printed, too.
    "do_not_mutate_patterns": [r"(logger|log|warnings)\.", r"raise \w", r"def __(repr|str)__"],
}


def main(folder: str, number: int, seed: int) -> int:
    if importlib.util.find_spec("mutmut") is None:
        sys.exit("fuzz.mutants: mutmut is missing: ./run python -m pip install -e '.[mutants]'")
    shutil.rmtree(BUILD, ignore_errors=True)
    BUILD.mkdir(parents=True)
    tracked = subprocess.run(["git", "ls-files"], capture_output=True, text=True, check=True).stdout
    names = sorted({name.split("/")[0] for name in tracked.split()} - {"pyproject.toml"})
    for name in names:
        (BUILD / name).symlink_to(Path(name).resolve())
    options = OPTIONS | {"only_mutate": [f"libmodbus_py/{folder}/*"], "also_copy": names}
    options["pytest_add_cli_args_test_selection"] = [f"tests/{folder}"]
    rows = "".join(f"{name} = {json.dumps(value)}\n" for name, value in options.items())
    text = Path("pyproject.toml").read_text()
    (BUILD / "pyproject.toml").write_text(f"{text}\n[tool.mutmut]\n{rows}")
    command = [sys.executable, "-m", "mutmut", "run"]
    # Makes all mutants, and ends because none has this name.
    subprocess.run([*command, "none"], cwd=BUILD, check=False, stderr=subprocess.DEVNULL)
    records = [json.loads(path.read_text()) for path in sorted(BUILD.glob("mutants/**/*.meta"))]
    mutants = [name for record in records for name in record["exit_code_by_key"]]
    drawn = random.Random(seed).sample(mutants, min(number, len(mutants)))
    return subprocess.run([*command, *drawn], cwd=BUILD, check=False).returncode


if __name__ == "__main__":
    folder, number, seed = (sys.argv[1:] + ["maps", "200", "1"][len(sys.argv) - 1 :])[:3]
    sys.exit(main(folder, int(number), int(seed)))
