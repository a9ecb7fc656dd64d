"""
Try each block of commands of docs/how-to/install.md, and the quick tests, in a new Debian.

    ./run python -m tests.packaging.roots [-k bookworm] [pytest arguments]

The blocks run as root, the tests as an ordinary user who has sudo, under the umask 077, and as in
a container: /sys can only be read.

The folder `build/roots`, or the one that ROOTS names, keeps every download: the minimal systems,
the packages of Debian and those of PyPI. What ran before, with the same commands and needs, runs
without any network. Each system has an unpacked source archive of this clone in the user's home,
is unpacked into the folder of temporary files, takes up to 1.5 GB there, and is removed. `./run
test` does none of this, which takes minutes; `.ci/run` tries the tests in the Debian that it does
not run on: `-k 'quick and other'`.
"""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
CACHE = Path(os.environ.get("ROOTS", ROOT / "build" / "roots"))
PAGE = ROOT / "docs" / "how-to" / "install.md"

PYTHONS = {"bookworm": "3.11", "trixie": "3.13"}  # releases of Debian, 12 and 13, and their Python

WAYS = {"source": "python3-dev python3-venv", "deb": "packaging/deb.py", "wheel": "./run wheel"}
"""The ways to install, and what only the block of each has."""

QUICK = "./run test --quick tests/server"
"""The tests that need none of Debian's programs, and those of servers."""

PROGRAMS = ("debootstrap", "unshare", "chroot", "ip", "tar")

USER = "somebody"

LONGEST_S = 3600  # of a block: `./run wheel` builds libmodbus and the wheel twice, and runs tests

SOURCES = """\
deb http://deb.debian.org/debian {0} main
deb http://deb.debian.org/debian {0}-updates main
deb http://deb.debian.org/debian-security {0}-security main
"""

APT = """\
APT::Get::Assume-Yes "true";
APT::Keep-Downloaded-Packages "true";
Binary::apt::APT::Keep-Downloaded-Packages "true";
"""

# In namespaces of its own, which take what is mounted with them.
ENTER = """\
set -e
{loopback}
mount -t proc proc proc
mount -t sysfs -o ro sys sys
mount -t devpts -o newinstance,ptmxmode=666 devpts dev/pts
mount -t tmpfs shm dev/shm
mount --bind {debs} var/cache/apt/archives
mount --bind {wheels} mnt
exec chroot . env -i HOME={home} PATH=/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 \
    DEBIAN_FRONTEND=noninteractive PIP_NO_INDEX=1 PIP_FIND_LINKS=/mnt {become} sh -exc "$1"
"""

BECOME_USER = f"setpriv --reuid={USER} --regid={USER} --init-groups"


def why_not() -> str:
    """Return why no system can be made on this machine, or nothing."""
    if os.geteuid():
        return "only root can make a system to try it in"
    if missing := [program for program in PROGRAMS if shutil.which(program) is None]:
        return f"not installed: {', '.join(missing)}"
    command = ["unshare", "--mount", "--pid", "--net", "--fork", "true"]
    process = subprocess.run(command, capture_output=True, text=True)
    return process.stderr.strip()  # such as in a container without privileges


MADE_HERE = pytest.mark.skipif(bool(reason := why_not()), reason=reason)


def block(way: str) -> str:
    """Return the commands that the page has for a way to install."""
    blocks = re.findall(r"```sh\n(.*?)```", PAGE.read_text(), re.DOTALL)
    (text,) = (block for block in blocks if WAYS[way] in block)
    return str(text)


def commands(way: str) -> str:
    """Return the commands of a way to install, or those of the quick tests."""
    return QUICK if way == "quick" else block(way)


def is_other(release: str) -> bool:
    """Return whether this machine has another Debian, or none."""
    return f"VERSION_CODENAME={release}\n" not in Path("/etc/os-release").read_text()


def kept(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


class Needs:
    """What a block downloads in a release, and whether it was downloaded before."""

    def __init__(self, release: str, way: str) -> None:
        self.release = release
        self.debs = kept(CACHE / release / "debs")
        self.wheels = kept(CACHE / release / "wheels")
        (self.debs / "partial").mkdir(exist_ok=True)
        texts = [commands(way), *((ROOT / name).read_text() for name in ("run", "pyproject.toml"))]
        texts += [(ROOT / "packaging" / "debian" / "control").read_text()]
        digest = hashlib.sha256("".join(texts).encode()).hexdigest()
        self.stamp = CACHE / release / f"{way}-{digest[:12]}"

    def fetch(self) -> None:
        """Download what pip and the build of libmodbus need; apt downloads while the block runs."""
        project = tomllib.loads((ROOT / "pyproject.toml").read_text())
        extras = project["project"]["optional-dependencies"]
        lines = [*project["build-system"]["requires"], *project["project"]["dependencies"]]
        needs = [Requirement(line) for line in [*lines, *extras["wheel"], *extras["test"]]]
        python = PYTHONS[self.release]
        requirements = []
        for need in needs:
            # pip itself takes markers for those of the Python that runs it.
            if need.marker is None or need.marker.evaluate({"python_version": python}):
                need.marker = None
                requirements.append(str(need))
        machine = os.uname().machine
        platforms = [f"--platform=manylinux_2_{minor}_{machine}" for minor in range(5, 37)]
        run_here(
            sys.executable, "-m", "pip", "download", "-q", "--only-binary=:all:", "-d", self.wheels,
            f"--python-version={python}", *platforms, *requirements,
        )  # fmt: skip
        run_here(
            sys.executable, "-c", "import libmodbus; libmodbus.fetch()", cwd=ROOT / "packaging"
        )


def run_here(*command: object, cwd: Path = ROOT) -> None:
    process = subprocess.run(list(map(str, command)), cwd=cwd, capture_output=True, text=True)
    assert process.returncode == 0, process.stdout[-2000:] + process.stderr[-2000:]


def base(release: str) -> Path:
    """Return a tarball of a minimal system that knows the packages of its release."""
    archive = kept(CACHE / release) / "system.tar"
    if not archive.exists():
        folder = CACHE / release / "base"
        shutil.rmtree(folder, ignore_errors=True)
        run_here("debootstrap", "--variant=minbase", "--include=sudo", release, folder)
        run_here("chroot", folder, "useradd", "--create-home", USER)
        (folder / "etc/sudoers.d" / USER).write_text(f"{USER} ALL=(ALL) NOPASSWD: ALL\n")
        (folder / "etc/apt/sources.list").write_text(SOURCES.format(release))
        run_here("chroot", folder, "apt-get", "update", "-q")
        run_here("chroot", folder, "apt-get", "clean")
        run_here("tar", "--one-file-system", "-cf", archive.with_suffix(".new"), "-C", folder, ".")
        shutil.rmtree(folder)
        archive.with_suffix(".new").rename(archive)
    return archive


@pytest.fixture
def system(release: str, tmp_path: Path) -> Iterator[Path]:
    """Unpack a minimal system that has the files of this clone, and answers questions of apt."""
    tarball, folder = base(release), tmp_path / release
    folder.mkdir()
    run_here("tar", "-xf", tarball, "-C", folder)
    (folder / "etc/apt/apt.conf.d/99roots").write_text(APT)
    (folder / "etc/dpkg/dpkg.cfg.d/roots").write_text("force-unsafe-io\n")  # it is thrown away
    shutil.copy("/etc/resolv.conf", folder / "etc/resolv.conf")
    made_here = [line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()]
    for home in ("root", f"home/{USER}"):
        clone = folder / home / "libmodbus-py"
        shutil.copytree(ROOT, clone, ignore=shutil.ignore_patterns(*made_here, ".git"))
    run_here("chroot", folder, "chown", "-R", f"{USER}:{USER}", f"/home/{USER}")
    yield folder
    shutil.rmtree(folder)


@MADE_HERE
@pytest.mark.timeout(LONGEST_S)
@pytest.mark.parametrize("release", PYTHONS)
@pytest.mark.parametrize("way", WAYS)
def test_a_block_works_in_a_new_system(release, way, request) -> None:
    assert "all answers are right" in output(release, way, request)


@MADE_HERE
@pytest.mark.timeout(LONGEST_S)
@pytest.mark.parametrize(
    "release",
    [pytest.param(item, id=f"{item}-other" if is_other(item) else item) for item in PYTHONS],
)
def test_quick_tests_pass_for_an_ordinary_user(release, request) -> None:
    assert re.search(r"\d{4} passed", output(release, "quick", request))


def output(release: str, way: str, request: pytest.FixtureRequest) -> str:
    """Run the commands in a new system, print how it went, and return all that they print."""
    needs = Needs(release, way)
    is_ready = needs.stamp.exists()
    if not is_ready:
        needs.fetch()
    folder = request.getfixturevalue("system")
    home, become = (f"/home/{USER}", BECOME_USER) if way == "quick" else ("/root", "")
    # Without a network there is nothing but the loopback, which clients and servers talk on.
    unshare = ["unshare", "--mount", "--pid", "--fork", "--kill-child", *["--net"] * is_ready]
    loopback = "ip link set lo up" if is_ready else ""
    enter = ENTER.format(
        loopback=loopback, debs=needs.debs, wheels=needs.wheels, home=home, become=become
    )
    steps = f"cd {home}/libmodbus-py\n{commands(way)}"
    start = time.monotonic()
    process = subprocess.run(
        [*unshare, "sh", "-c", enter, "sh", steps],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        umask=0o077 if become else -1,
    )
    seconds = time.monotonic() - start
    assert process.returncode == 0, process.stdout[-6000:]
    lines = [line for line in process.stdout.splitlines() if line.startswith("+ ")]
    last = process.stdout.rstrip().rpartition("\n")[2]
    network = "without a network" if is_ready else "with the network"
    print(f"\n{release}, {way}, {network}: {seconds:.0f} s", *lines, last, sep="\n    ")
    needs.stamp.touch()
    return process.stdout


if __name__ == "__main__":
    # In another process, so that pytest imports first the modules that it rewrites.
    options = ("-s", "-rs", "-p", "no:cacheprovider")
    os.execv(sys.executable, [sys.executable, "-m", "pytest", __file__, *options, *sys.argv[1:]])
