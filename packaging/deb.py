"""
Build the Debian package, and check it: python3 packaging/deb.py FOLDER

The source is that of this clone; what Debian needs beside it is in packaging/debian. FOLDER gets
the source package and the binary package. Debian's programs for it are installed by the first
line, and what checks the package before a release by the second:

    apt-get build-dep ./packaging
    apt-get install lintian
"""

from __future__ import annotations

import gzip
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
DEBIAN = ROOT / "packaging" / "debian"


def main(folder: Path) -> None:
    """
    Build the package, print the files that were made, and let lintian check them, if it is there.

    Raises:
        SystemExit: a program is missing, a step failed, or lintian found an error.
    """
    if shutil.which("dpkg-buildpackage") is None:
        raise SystemExit("deb: there is no dpkg-buildpackage: see packaging/deb.py")
    text = (DEBIAN / "changelog").read_text()
    upstream = re.findall(r"^libmodbus-py \(([^-]+)-", text)[0]
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        tree = place / f"libmodbus-py-{upstream}"
        packed = _source(tree.name)
        (place / f"libmodbus-py_{upstream}.orig.tar.gz").write_bytes(packed)
        with tarfile.open(fileobj=io.BytesIO(packed)) as tarball:
            tarball.extractall(place, **({"filter": "data"} if sys.version_info >= (3, 12) else {}))
        shutil.copytree(DEBIAN, tree / "debian")
        command = ["dpkg-buildpackage", "-us", "-uc", "--no-sign", "-F"]
        if subprocess.run(command, cwd=tree, check=False, stdout=sys.stderr).returncode:
            raise SystemExit("deb: dpkg-buildpackage failed")
        for path in sorted(place.glob("*libmodbus-py*_*")):
            shutil.copy(path, folder)
            print(folder / path.name)
        if shutil.which("lintian") is None:
            print("deb: not checked, because there is no lintian", file=sys.stderr)
            return
        changes = [str(path) for path in place.glob("*.changes")]
        if subprocess.run(["lintian", "--fail-on", "error", *changes], check=False).returncode:
            raise SystemExit("deb: lintian found an error")


def files(root: Path = ROOT) -> list[str]:
    """
    Return what belongs to the package: what git knows and is there.

    Where nothing is known to git, such as in an unpacked sdist, it is all that .gitignore does not
    name.

    Raises:
        SystemExit: git refused, and said why.
    """
    if (root / ".git").exists():
        # This program comes from the clone, so that a clone of another user is trusted, too.
        command = ["git", "-c", "safe.directory=*", "ls-files", "-z"]
        found = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
        if found.returncode:
            raise SystemExit(f"deb: {found.stderr.strip()}")
        names = found.stdout.split("\0")
    else:
        made = [line.strip("/") for line in (root / ".gitignore").read_text().splitlines()]
        names = [
            str(path)
            for path in (path.relative_to(root) for path in root.rglob("*"))
            if not any(part.match(entry) for part in (path, *path.parents) for entry in made)
        ]
    return sorted(name for name in names if (root / name).is_file())


def _source(top: str) -> bytes:
    """Return the files of this clone as a tarball, without what Debian adds."""
    made = io.BytesIO()
    with (
        gzip.GzipFile("", "wb", 9, made, mtime=0) as packed,
        tarfile.open(fileobj=packed, mode="w") as tarball,
    ):
        for name in files():
            if not name.startswith("packaging/debian/"):
                tarball.add(ROOT / name, f"{top}/{name}", filter=_without_user)
    return made.getvalue()


def _without_user(member: tarfile.TarInfo) -> tarfile.TarInfo:
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    member.mtime = int(os.environ.get("SOURCE_DATE_EPOCH", member.mtime))
    return member


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(Path(sys.argv[1]).resolve())
