"""
Build libmodbus from its release, as Debian keeps it: python packaging/libmodbus.py PREFIX

Wheels carry this library. Its tarball stays beside this file, so that the source
distribution has it, too.
"""

from __future__ import annotations

import hashlib
import io
import subprocess
import sys
import tarfile
import tempfile
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path

VERSION = "3.1.11"
NAME = f"libmodbus_{VERSION}.orig.tar.gz"
# As in Debian's signed index of sources (libmodbus_3.1.11-2.dsc).
SHA256 = "8a750452ef86a53de6cec6fbca67bd5be08d0a1e87278a422fbce3003fd42d99"

# Debian drops a version when a newer one comes; its archive of snapshots drops none.
PLACES = (
    f"https://deb.debian.org/debian/pool/main/libm/libmodbus/{NAME}",
    f"http://deb.debian.org/debian/pool/main/libm/libmodbus/{NAME}",
    f"https://snapshot.debian.org/archive/debian/20250901T000000Z/pool/main/libm/libmodbus/{NAME}",
)

TARBALL = Path(__file__).parent / NAME


def fetch() -> bytes:
    """
    Return the tarball, from beside this file or else from Debian.

    Raises:
        SystemExit: it cannot be had, or is another one.
    """
    data = TARBALL.read_bytes() if TARBALL.exists() else _download()
    found = hashlib.sha256(data).hexdigest()
    if found != SHA256:
        raise SystemExit(f"libmodbus: {NAME} has the SHA-256 {found}, not {SHA256}")
    TARBALL.write_bytes(data)
    return data


def _download() -> bytes:
    failures = []
    for place in PLACES:
        try:
            with urllib.request.urlopen(place, timeout=30) as answer:
                return bytes(answer.read())
        except (OSError, urllib.error.URLError) as error:
            failures.append(f"{place}: {error}")
    raise SystemExit("libmodbus: " + "; ".join(failures))


def build(prefix: Path, change: Callable[[Path], object] = lambda source: None) -> None:
    """
    Build and install the shared library and its headers.

    Args:
        prefix: where `lib` and `include` are made.
        change: called with the folder of the source before it is built.

    Raises:
        SystemExit: a step failed; its output is told.
    """
    fetch()
    with tempfile.TemporaryDirectory() as place:
        _run(["tar", "xf", str(TARBALL)], Path(place))
        source = Path(place) / f"libmodbus-{VERSION}"
        change(source)
        for step in (
            ["autoreconf", "-i"],
            ["./configure", f"--prefix={prefix}", f"--libdir={prefix}/lib", "--disable-static",
             "--disable-tests", "CFLAGS=-O2 -fstack-protector-strong",
             # libmodbus has its own; glibc's is that of 2.38, which Debian 12 lacks.
             "ac_cv_func_strlcpy=no",
             "LDFLAGS=-Wl,-z,relro,-z,now"],
            ["make", "-s"],
            ["make", "-s", "install"],
        ):  # fmt: skip
            _run(step, source)


def licence() -> bytes:
    """Return the text of the licence that the library comes with."""
    with tarfile.open(fileobj=io.BytesIO(fetch())) as tarball:
        member = tarball.extractfile(f"libmodbus-{VERSION}/COPYING.LESSER")
        assert member is not None
        return member.read()


def _run(step: list[str], where: Path) -> None:
    done = subprocess.run(step, cwd=where, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"libmodbus: {' '.join(step)}:\n{done.stdout}{done.stderr}")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    build(Path(sys.argv[1]).resolve())
