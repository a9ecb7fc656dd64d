"""
The sdist and the wheel that were made: what is in them, and that they work alone.

`./run wheel` calls it, with both in the environment as SDIST and WHEEL.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path
from typing import Any

import libmodbus
import make
import pytest
import sbom

SDIST, WHEEL = Path(os.environ["SDIST"]), Path(os.environ["WHEEL"])

# Says which libmodbus is loaded: its version, and every file of this name in the process.
WHICH = """
from libmodbus_py.binding.library import loaded_version
files = {line.split()[-1] for line in open("/proc/self/maps") if "libmodbus" in line.split("/")[-1]}
print(loaded_version(), *sorted(file for file in files if "libmodbus-" in file or ".so.5" in file))
"""


@pytest.fixture(scope="module")
def names() -> list[str]:
    with zipfile.ZipFile(WHEEL) as wheel:
        return wheel.namelist()


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A virtual environment that has the wheel, and what it depends on."""
    place = tmp_path_factory.mktemp("wheel")
    venv.create(place, with_pip=True)
    run(place / "bin" / "pip", "install", "-q", "--disable-pip-version-check", WHEEL)
    return place


def run(*command: object) -> str:
    # Nothing of the folder that this is started in, or of the caller's Python, is imported.
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [str(word) for word in command], cwd="/", env=env, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def text_of(ending: str) -> str:
    with zipfile.ZipFile(WHEEL) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith(ending))
        return wheel.read(name).decode()


# --- what is in the wheel ------------------------------------------------------------------


def test_the_wheel_contains_nothing_that_only_a_compiler_reads(names: list[str]) -> None:
    allowed = r"\.(py|so|so\.[0-9.]+|toml|csv|html|css|js|svg|pyi)$|/py\.typed$|\.dist-info/"
    allowed += r"|\.data/data/share/(man/man1|bash-completion/completions|zsh/site-functions)/"
    assert [name for name in names if not re.search(allowed, name)] == []


def test_the_wheel_and_the_sdist_contain_all_licences(names: list[str]) -> None:
    found = [name.partition("/licenses/")[2] for name in names if "/licenses/" in name]
    assert sorted(found) == ["LICENSE", "libmodbus/COPYING.LESSER", "libmodbus/NOTICE"]
    metadata = text_of("/METADATA")
    assert re.findall("License-File: (.*)", metadata) == [
        "libmodbus/COPYING.LESSER",
        "libmodbus/NOTICE",
        "LICENSE",
    ]
    assert "License-Expression: MIT AND LGPL-2.1-or-later\n" in metadata
    assert "GNU LESSER GENERAL PUBLIC LICENSE" in text_of("/COPYING.LESSER")


def test_the_notice_names_the_library_and_offers_its_source(names: list[str]) -> None:
    notice = text_of("/NOTICE")
    (library,) = (name for name in names if name.startswith("libmodbus_py.libs/libmodbus-"))
    for said in (library, libmodbus.VERSION, libmodbus.SHA256, libmodbus.NAME, "three years"):
        assert said in notice
    with tarfile.open(SDIST) as sdist:
        (source,) = (path for path in sdist if path.name.endswith(f"packaging/{libmodbus.NAME}"))
        data = sdist.extractfile(source)
        assert data is not None
        assert hashlib.sha256(data.read()).hexdigest() == libmodbus.SHA256


def test_the_bill_of_materials_names_what_the_wheel_contains(names: list[str]) -> None:
    """PEP 770; the form is checked when it is written."""
    bom = json.loads(text_of(f".dist-info/{sbom.FOLDER}/{sbom.NAME}"))
    own = bom["metadata"]["component"]
    version = re.findall("^Version: (.*)$", text_of("/METADATA"), re.MULTILINE)
    assert (own["name"], [own["version"]]) == ("libmodbus-py", version)
    parts = {component["name"]: component for component in bom["components"]}
    assert set(parts) == {"libmodbus", "cffi"}
    assert all(row["supplier"]["name"] for row in [own, *parts.values()])
    (library,) = (name for name in names if name.startswith("libmodbus_py.libs/"))
    with zipfile.ZipFile(WHEEL) as wheel:
        digest = hashlib.sha256(wheel.read(library)).hexdigest()
    check_libmodbus(parts["libmodbus"], library, digest)
    needs = {component["ref"]: component.get("dependsOn", []) for component in bom["dependencies"]}
    assert set(needs[own["bom-ref"]]) == {part["bom-ref"] for part in parts.values()}


def test_the_bill_of_materials_of_the_sdist_names_the_source_that_the_sdist_contains() -> None:
    with tarfile.open(SDIST) as sdist:
        (name,) = (path for path in sdist if path.name.endswith(f"packaging/{sbom.NAME}"))
        file = sdist.extractfile(name)
        assert file is not None
        parts = {component["name"]: component for component in json.load(file)["components"]}
    check_libmodbus(parts["libmodbus"], f"packaging/{libmodbus.NAME}", libmodbus.SHA256)


def check_libmodbus(part: dict[str, Any], place: str, digest: str) -> None:
    assert part["version"] == libmodbus.VERSION
    assert part["cpe"] == f"cpe:2.3:a:libmodbus:libmodbus:{libmodbus.VERSION}:*:*:*:*:*:*:*"
    assert part["licenses"] == [{"license": {"id": "LGPL-2.1-or-later"}}]
    assert part["evidence"]["occurrences"] == [{"location": place}]
    assert part["hashes"] == [{"alg": "SHA-256", "content": digest}]
    (source,) = (entry for entry in part["externalReferences"] if "hashes" in entry)
    assert source["type"] == "source-distribution"
    assert source["url"].endswith(libmodbus.NAME)
    assert source["hashes"] == [{"alg": "SHA-256", "content": libmodbus.SHA256}]


def test_there_are_a_manual_page_and_completion_where_shells_look(home: Path) -> None:
    assert (home / "share/man/man1/libmodbus-py.1").read_text().startswith(".TH LIBMODBUS-PY 1")
    for shell in ("bash-completion/completions/libmodbus-py", "zsh/site-functions/_libmodbus-py"):
        assert (home / "share" / shell).exists()


def test_a_second_build_under_another_umask_gives_the_same_bytes(tmp_path: Path) -> None:
    before = os.umask(0o077)
    try:
        again = make.made(tmp_path)
    finally:
        os.umask(before)
    assert [entry.name for entry in again] == [SDIST.name, WHEEL.name]
    equal = [a.read_bytes() == b.read_bytes() for a, b in zip(again, (SDIST, WHEEL), strict=True)]
    assert equal == [True, True]


def test_the_steps_of_cibuildwheel_give_the_same_bytes(tmp_path: Path) -> None:
    """It builds a wheel of the tree, and calls repair.py as a program."""
    root = Path(__file__).parents[1]
    environment = os.environ | {
        "CFLAGS": f"-I{make.PREFIX}/include",
        "LDFLAGS": f"-L{make.PREFIX}/lib",
        "LD_LIBRARY_PATH": f"{make.PREFIX}/lib",
    }

    def step(*command: object) -> subprocess.CompletedProcess[str]:
        words = [sys.executable, *map(str, command)]
        return subprocess.run(
            words, cwd=root, env=environment, umask=0o077, capture_output=True, text=True
        )

    shutil.rmtree(root / "build" / "lib", ignore_errors=True)
    built = step("-m", "build", "--wheel", "--outdir", tmp_path, root)
    assert built.returncode == 0, built.stdout + built.stderr
    (plain,) = tmp_path.glob("*.whl")
    repaired = step("packaging/repair.py", plain, tmp_path / "repaired")
    assert repaired.returncode == 0, repaired.stdout + repaired.stderr
    (wheel,) = (tmp_path / "repaired").iterdir()
    assert (wheel.name, wheel.read_bytes() == WHEEL.read_bytes()) == (WHEEL.name, True)
    del environment["SOURCE_DATE_EPOCH"]
    refused = step("packaging/repair.py", plain, tmp_path / "repaired")
    told = "repair: set SOURCE_DATE_EPOCH to the time of the commit\n"
    assert (refused.returncode, refused.stderr) == (1, told)


def test_lintian_of_debian_12_accepts_the_wheel() -> None:
    if "manylinux" in WHEEL.name:
        assert "Debian 12" in make.systems(WHEEL.name).partition("; refused")[0]


def test_the_wheel_fits_every_python_from_311_on() -> None:
    assert re.search(r"-cp311-abi3-(many|musl)linux", WHEEL.name)


# --- that it works alone -------------------------------------------------------------------


def test_the_wheel_loads_its_own_library(home: Path) -> None:
    version, *files = run(home / "bin" / "python", "-c", WHICH).rsplit(") ", 1)
    assert version == f"({libmodbus.VERSION.replace('.', ', ')}"
    assert len(files) == 1
    assert files[0].startswith(str(home))


def test_the_wheel_runs_the_demonstration(home: Path) -> None:
    assert "all answers are right" in run(home / "bin" / "libmodbus-py", "demo")


def test_the_sdist_contains_the_examples(home: Path) -> None:
    loads = (
        "from libmodbus_py.device_file import load\n"
        "from libmodbus_py.tools.simulator import example_files as these\n"
        "for name in these.described(): print(name, load(these.path_of(name)))"
    )
    told = run(home / "bin" / "python", "-c", loads)
    assert [line.split()[0] for line in told.splitlines()] == sorted(
        path.stem
        for path in (Path(__file__).parents[1] / "examples").glob("*.toml")
        if path.stem not in ("fleet", "gateway")
    )


def test_the_library_of_the_wheel_can_be_exchanged(home: Path, tmp_path: Path) -> None:
    """As its licence wants: for one that somebody changed, under the same name."""

    def changed(source: Path) -> None:
        file = source / "configure.ac"
        text = file.read_text()
        assert "[libmodbus_version_micro], [11]" in text
        file.write_text(text.replace("_micro], [11]", "_micro], [99]"))

    libmodbus.build(tmp_path, changed)
    (own,) = home.glob("lib/python*/site-packages/libmodbus_py.libs/libmodbus-*")
    kept = tmp_path / "kept"
    shutil.copy(own, kept)
    try:
        shutil.copy(tmp_path / "lib" / "libmodbus.so.5", own)
        assert run(home / "bin" / "python", "-c", WHICH).startswith("(3, 1, 99) ")
        assert "all answers are right" in run(home / "bin" / "libmodbus-py", "demo")
    finally:
        shutil.copy(kept, own)


# --- the sdist -----------------------------------------------------------------------------


def test_the_sdist_contains_what_its_tests_need(tmp_path: Path) -> None:
    with tarfile.open(SDIST) as sdist:
        inside = {path.name.partition("/")[2] for path in sdist if path.isfile()}
    root = Path(__file__).parents[1]
    if not (root / ".git").exists():
        pytest.skip("this is no clone, so nobody knows which files belong to it")
    listed = subprocess.run(["git", "ls-files"], cwd=root, capture_output=True, text=True)
    missing = set(listed.stdout.split("\n")) - inside - {""}
    assert sorted(missing) == []


def test_the_sdist_passes_its_own_tests(tmp_path: Path) -> None:
    """Some, which need no program of Debian: unpacked elsewhere, ./run test runs all."""
    with tarfile.open(SDIST) as sdist:
        sdist.extractall(tmp_path, filter="data") if sys.version_info >= (3, 12) else (
            sdist.extractall(tmp_path)
        )
    (tree,) = tmp_path.iterdir()
    run(
        "sh",
        "-c",
        f"cd {tree} && ./run python -m pytest -n auto -q tests/protocol tests/test_package.py",
    )
