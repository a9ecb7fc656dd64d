"""
Make what an index wants: an sdist, and a wheel of this machine that carries libmodbus.

`./run wheel` calls it. What was made lies in dist, and was tried.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import libmodbus
import sbom
from repair import repair

ROOT = Path(__file__).parents[1]
PREFIX = ROOT / "build" / "libmodbus"
BUILT, DIST = ROOT / "build" / "wheel", ROOT / "dist"


def main() -> None:
    """
    Build, repair, check, try.

    Raises:
        SystemExit: a step failed; its output is told.
    """
    _say(f"building libmodbus {libmodbus.VERSION}")
    libmodbus.build(PREFIX)
    source = libmodbus.TARBALL
    text = sbom.sbom(source.relative_to(ROOT).as_posix(), source.read_bytes())
    (ROOT / "packaging" / sbom.NAME).write_text(text)
    _say("building the sdist, and from it the wheel")
    for old in (BUILT, DIST):
        shutil.rmtree(old, ignore_errors=True)
    # The compiler takes this libmodbus, not the one of the system; so does auditwheel.
    os.environ |= {
        "CFLAGS": f"-I{PREFIX}/include",
        "LDFLAGS": f"-L{PREFIX}/lib",
        "LD_LIBRARY_PATH": f"{PREFIX}/lib",
    }
    _run("build", "--outdir", str(BUILT), str(ROOT))
    (sdist,), (plain,) = BUILT.glob("*.tar.gz"), BUILT.glob("*.whl")
    _say("putting libmodbus into the wheel")
    wheel = repair(plain, DIST, libmodbus.licence())
    sdist = Path(shutil.copy(sdist, DIST))
    for name in ("CFLAGS", "LDFLAGS", "LD_LIBRARY_PATH"):
        del os.environ[name]
    _say("trying both")
    _run("twine", "check", "--strict", str(sdist), str(wheel))
    os.environ |= {"SDIST": str(sdist), "WHEEL": str(wheel)}
    # The suite's own settings of pytest mean nothing here.
    tried = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-c", os.devnull, "--rootdir", str(ROOT),
         str(ROOT / "packaging")],
        check=False,
    )  # fmt: skip
    if tried.returncode:
        raise SystemExit("wheel: what was made fails its tests")
    for made in (sdist, wheel):
        print(made.relative_to(ROOT))


def _say(text: str) -> None:
    print(f"wheel: {text}", file=sys.stderr)


def _run(tool: str, *arguments: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", tool, *arguments], capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise SystemExit(f"{tool} {' '.join(arguments)}:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    main()
