"""
Run the demonstration and the tests of bytes, devices and maps on other processors.

    ./run python -m tests.packaging.processors [armhf arm64 s390x]

32 bits, another alignment, and the other order of bytes. Debian's packages for them are unpacked
below `build/processors`, 200 MB each, qemu-user runs their Python. It installs what is missing:
qemu-user-static, gcc and libc of each. Tests that start programs or measure time are left out.
"""

import os
import runpy
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
BUILD = ROOT / "build" / "processors"
PACKAGES = ("python3", "libpython3-dev", "libmodbus-dev", "python3-cryptography")
FOLDERS = ("tests/protocol", "tests/device", "tests/maps")
TESTS = ("pytest", "pytest-timeout", "hypothesis<6.156", "pymodbus", "openpyxl")
"""What tests import, in Python alone."""
LEFT_OUT = ("flood_costs_little", "full_mapping", "in_a_circle", "killed_at_any_step", "TestForks")


class Processor(NamedTuple):
    triplet: str
    qemu: str


PROCESSORS = {
    "armhf": Processor("arm-linux-gnueabihf", "qemu-arm-static"),
    "arm64": Processor("aarch64-linux-gnu", "qemu-aarch64-static"),
    "s390x": Processor("s390x-linux-gnu", "qemu-s390x-static"),
}


def run(*command: object, **options: Any) -> None:
    subprocess.run(list(map(str, command)), check=True, **options)


def install(names: list[str]) -> None:
    """Install what Debian has to compile and run for processors, with sudo if need be."""
    programs = {PROCESSORS[names[0]].qemu: "qemu-user-static"}
    for name in names:
        triplet = PROCESSORS[name].triplet
        programs[f"{triplet}-gcc"] = f"gcc-{triplet} libc6-dev-{name}-cross"
    missing = [packages for program, packages in programs.items() if not shutil.which(program)]
    if missing:
        apt = [*["sudo"] * (os.getuid() != 0), "apt-get", "-q", "-y", "--no-install-recommends"]
        run(*apt, "update", stdout=subprocess.DEVNULL)
        run(*apt, "install", *" ".join(missing).split(), stdout=subprocess.DEVNULL)


def unpack(name: str) -> Path:
    """Return a folder with Debian's Python and libmodbus for a processor."""
    folder = BUILD / name
    if not (folder / "unpacked").exists():
        state, cache = folder / "state", folder / "cache"
        for entry in (state / "lists/partial", cache / "archives/partial", folder / "usr/lib"):
            entry.mkdir(parents=True, exist_ok=True)
        (folder / "lib").symlink_to("usr/lib")  # as Debian has it
        (state / "status").touch()  # nothing is installed
        apt = ["apt-get", "-q", "-y", "--no-install-recommends"]
        apt += ["-o", f"APT::Architecture={name}", "-o", f"APT::Architectures={name}"]
        apt += ["-o", f"Dir::State={state}", "-o", f"Dir::State::status={state}/status"]
        apt += ["-o", f"Dir::Cache={cache}", "-o", "Dir::Etc::SourceParts=/dev/null"]
        apt += ["-o", "APT::Sandbox::User=", "-o", f"Dir::Etc::SourceList={folder}/sources.list"]
        (folder / "sources.list").write_text("deb http://deb.debian.org/debian bookworm main\n")
        run(*apt, "update", stdout=subprocess.DEVNULL)
        run(*apt, "--download-only", "install", *PACKAGES, stdout=subprocess.DEVNULL)
        for package in cache.glob("archives/*.deb"):
            run("dpkg-deb", "-x", package, folder)
        shutil.rmtree(cache)
        (folder / "unpacked").touch()
    return folder


def build(name: str, root: Path) -> Path:
    """Return a copy of this clone with the C modules of a processor."""
    clone = root / "clone"
    shutil.rmtree(clone, ignore_errors=True)
    ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
    ignored.remove("*.egg-info")  # of which pytest takes the plugin, and the modules it rewrites
    shutil.copytree(ROOT, clone, ignore=shutil.ignore_patterns(*ignored, ".git"))
    triplet = PROCESSORS[name].triplet
    modules = runpy.run_path(str(ROOT / "build_ffi.py"))
    (include,) = root.glob("usr/include/python3*")
    for module, path in (("ffi", "binding/_libmodbus"), ("scan", "protocol/_scan")):
        source = root / f"{module}.c"
        modules[module].emit_c_code(str(source))
        run(
            f"{triplet}-gcc", "-shared", "-fPIC", "-O2", "-DPy_LIMITED_API=0x030b0000",
            f"--sysroot={root}", f"-I{include}", source, *["-lmodbus"] * (module == "ffi"),
            "-o", clone / "libmodbus_py" / f"{path}.abi3.so",
        )  # fmt: skip
    return clone


def try_on(name: str) -> None:
    root = unpack(name)
    clone = build(name, root)
    python = [PROCESSORS[name].qemu, "-L", root, *root.glob("usr/bin/python3.[0-9]*[0-9]")]
    environment = os.environ | {"PYTHONPATH": f"{BUILD / 'site'}:{clone}"}
    tests = ["pytest", "-q", "-m", "not slow", "-k", f"not ({' or '.join(LEFT_OUT)})", *FOLDERS]
    for arguments in (["libmodbus_py", "demo"], tests):
        start = time.monotonic()
        run(*python, "-m", *arguments, cwd=clone, env=environment)
        print(f"{name}, {arguments[0]}: {time.monotonic() - start:.0f} s", flush=True)


def main() -> None:
    names, site = sys.argv[1:] or [*PROCESSORS], BUILD / "site"
    install(names)
    if not site.exists():
        pip = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        pip += ["--python-version=3.11", "--only-binary=:all:", "--platform=any"]
        run(*pip, "--target", site, *TESTS)
    for name in names:
        try_on(name)


if __name__ == "__main__":
    main()
