"""
Make what an index wants: an sdist, and a wheel of this machine that carries libmodbus.

`./run wheel` calls it. What was made lies in dist, and was tried.
"""

from __future__ import annotations

import gzip
import os
import re
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import libmodbus
import sbom
from repair import repair, usual_mode

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
    os.environ.setdefault("SOURCE_DATE_EPOCH", _latest_change())
    text = sbom.sbom(source.relative_to(ROOT).as_posix(), source.read_bytes())
    (ROOT / "packaging" / sbom.NAME).write_text(text)
    for old in [*DIST.glob("*.whl"), *DIST.glob("*.tar.gz")]:  # a Debian package stays
        old.unlink()
    sdist, wheel = made(DIST)
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
    print(sdist.relative_to(ROOT))
    print(f"{wheel.relative_to(ROOT)}: {systems(wheel.name)}")


def made(folder: Path) -> tuple[Path, Path]:
    """
    Return an sdist and a wheel that were made in a folder; of the same files, always the same.

    Raises:
        SystemExit: a step failed; its output is told.
    """
    _say("building the sdist, and from it the wheel")
    for old in (BUILT, ROOT / "build" / "lib"):
        shutil.rmtree(old, ignore_errors=True)
    # The compiler takes this libmodbus, not the one of the system; so does auditwheel.
    own = {
        "CFLAGS": f"-I{PREFIX}/include",
        "LDFLAGS": f"-L{PREFIX}/lib",
        "LD_LIBRARY_PATH": f"{PREFIX}/lib",
    }
    os.environ |= own
    try:
        _run("build", "--outdir", str(BUILT), str(ROOT))
        (sdist,), (plain,) = BUILT.glob("*.tar.gz"), BUILT.glob("*.whl")
        _say("putting libmodbus into the wheel")
        wheel = repair(plain, folder, libmodbus.licence())
    finally:
        for name in own:
            del os.environ[name]
    return repacked(sdist, folder), wheel


def repacked(sdist: Path, folder: Path) -> Path:
    """Return a copy of an sdist that holds no time, order or user of the build."""
    time = int(os.environ["SOURCE_DATE_EPOCH"])
    path = folder / sdist.name
    with (
        tarfile.open(sdist) as old,
        path.open("wb") as file,
        gzip.GzipFile("", "wb", 9, file, mtime=time) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new,
    ):
        for entry in sorted(old, key=lambda each: each.name):
            entry.mtime, entry.uid, entry.gid, entry.uname, entry.gname = time, 0, 0, "", ""
            entry.mode, entry.pax_headers = usual_mode(entry.mode), {}
            new.addfile(entry, old.extractfile(entry) if entry.isfile() else None)
    return path


# Releases of systems, and their glibc.
GLIBC = {
    "Debian 11": (2, 31),
    "Ubuntu 22.04": (2, 35),
    "Debian 12": (2, 36),
    "Ubuntu 24.04": (2, 39),
    "Debian 13": (2, 41),
}


def systems(wheel: str) -> str:
    """Return the systems that take a wheel, by its name."""
    machine = wheel.removesuffix(".whl").rpartition("linux_")[2].split("_", 2)[-1]
    found = [tuple(map(int, match)) for match in re.findall(r"manylinux_(\d+)_(\d+)_", wheel)]
    if not found:
        return "for this machine only; an index would refuse it"
    lowest = min(found)
    takes = [name for name, glibc in GLIBC.items() if glibc >= lowest]
    refuse = [name for name in GLIBC if name not in takes]
    text = f"Linux on {machine} with glibc {lowest[0]}.{lowest[1]} or newer: {', '.join(takes)}"
    return f"{text}; refused by {', '.join(refuse)}" if refuse else text


def _latest_change() -> str:
    """Return the time of the latest commit; outside a clone, of the change log."""
    if not (ROOT / ".git").exists():  # and perhaps there is no git
        return str(int((ROOT / "CHANGELOG.md").stat().st_mtime))
    done = subprocess.run(
        ["git", "log", "-1", "--format=%ct"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


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
