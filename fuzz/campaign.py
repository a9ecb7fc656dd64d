"""
Coverage-guided fuzzing of everything: python -m fuzz.campaign [SECONDS]

SECONDS, 60 unless told otherwise, are split over the targets of `inputs`: the Python ones
run under atheris, the C helper under clang's libFuzzer with AddressSanitizer and
UndefinedBehaviorSanitizer. Every target begins with the worked examples. Prints how many
inputs each was given; a finding is kept in fuzz/findings, and makes it exit with 1.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from fuzz.command import numbers, progress
from fuzz.inputs import TARGETS

HERE = Path(__file__).parent
FINDINGS = HERE / "findings"

CLANG = "clang -g -O1 -fsanitize=fuzzer,address,undefined -fno-sanitize-recover=all"


def command(name: str, build: Path) -> list[str] | None:
    """Return the command that runs a target; None if this machine cannot."""
    if TARGETS[name].check is not None:
        if importlib.util.find_spec("atheris") is None:
            print(
                f"{name}: not run, there is no atheris for this Python ({sys.version.split()[0]})"
            )
            return None
        return [sys.executable, "-m", "fuzz.guided", name]
    if shutil.which("clang") is None:
        print(f"{name}: not run, there is no clang (apt install clang libclang-rt-dev)")
        return None
    program = build / name
    source = HERE / f"{name}.c"
    subprocess.run([*CLANG.split(), "-o", program, source, "-lmodbus"], check=True)
    return [str(program)]


def fuzz(name: str, seconds: int, scratch: Path) -> bool:
    """Run a target; False if it found something."""
    run = command(name, scratch)
    if run is None:
        return True
    corpus = scratch / f"{name}-corpus"
    corpus.mkdir()
    for number, seed in enumerate(TARGETS[name].seeds()):
        (corpus / str(number)).write_bytes(seed)
    before = set(FINDINGS.glob("*"))
    options = ["-max_len=2048", "-timeout=10", f"-artifact_prefix={FINDINGS}/{name}-"]
    options += [f"-max_total_time={seconds}"]
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent)}
    with progress(f"{name}, {seconds} s"):
        done = subprocess.run(
            [*run, *options, corpus],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=environment,
        )
    inputs = max((int(number) for number in re.findall(r"^#(\d+)\s", done.stdout, re.M)), default=0)
    print(f"{name}: {inputs} inputs, {'no finding' if done.returncode == 0 else 'A FINDING'}")
    if done.returncode:
        print(done.stdout[-6000:])
        print(*(f"kept as {path}" for path in set(FINDINGS.glob("*")) - before), sep="\n")
    return done.returncode == 0


def main() -> int:
    (seconds,) = numbers(__doc__, seconds=60)
    FINDINGS.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        each = max(1, seconds // len(TARGETS))
        good = [fuzz(name, each, Path(scratch)) for name in TARGETS]
    return 0 if all(good) else 1


if __name__ == "__main__":
    sys.exit(main())
