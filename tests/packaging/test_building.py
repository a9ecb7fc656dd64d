"""What is built, what the extras install, and the library that another build shares."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import zipfile
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from libmodbus_py.cli.commands import COMMANDS
from libmodbus_py.version import EXTRAS, how_to_add
from tests.support.cases import each_case

ROOT = Path(__file__).parents[2]
BINDING, PROTOCOL = ROOT / "libmodbus_py" / "binding", ROOT / "libmodbus_py" / "protocol"


def loaded(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("is_free", "tags"), [(1, {}), (0, {"py_limited_api": "cp311"})])
def test_the_limited_api_is_used_where_python_has_it(is_free, tags, monkeypatch) -> None:
    """A free-threaded Python has none, and setuptools refuses to ask for it there."""
    real = sysconfig.get_config_var

    def variable(name: str) -> Any:
        return is_free if name == "Py_GIL_DISABLED" else real(name)

    monkeypatch.setattr(sysconfig, "get_config_var", variable)
    assert loaded(ROOT / "setup.py").tags().get("bdist_wheel", {}) == tags


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return the files that the build reads."""
    place = tmp_path / "tree"
    place.mkdir()
    for name in ("setup.py", "build_ffi.py", "pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, place)
    (place / "packaging" / "docs").mkdir(parents=True)
    shutil.copy(ROOT / "packaging" / "docs" / "links.py", place / "packaging" / "docs")
    for folder in ("binding", "protocol"):
        (place / "libmodbus_py" / folder).mkdir(parents=True)
        for source in (ROOT / "libmodbus_py" / folder).glob("*.[ch]"):
            shutil.copy(source, place / "libmodbus_py" / folder)
    return place


@each_case(
    ("hidden", "packages"),
    [
        ("modbus/modbus.h", "libmodbus-dev"),
        ("Python.h", "python3-dev"),
        ("#include", "gcc libc6-dev python3-dev libmodbus-dev"),
    ],
)
def test_missing_packages_are_named_in_one_line(tree: Path, hidden: str, packages: str) -> None:
    compiler = tree / "cc"
    compiler.write_text(
        f"#!/bin/sh\n! grep -qF '{hidden}' && exit 0\necho raw errors >&2; exit 1\n"
    )
    compiler.chmod(0o755)
    process = subprocess.run(
        [sys.executable, "setup.py", "-q", "build_ext", "--build-lib", "built"],
        cwd=tree,
        env=os.environ | {"CC": str(compiler)},
        capture_output=True,
        text=True,
    )
    assert process.returncode == 1
    assert process.stderr.splitlines()[-1] == (
        "libmodbus-py is compiled against libmodbus of the system; install what is missing:"
        f" sudo apt install {packages}"
    )
    assert "raw errors" not in process.stderr


def test_generating_the_declarations_changes_no_file(tree: Path) -> None:
    """cffi would write its C over _libmodbus.c, which is ours."""
    before = {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()}
    process = subprocess.run(
        [sys.executable, "-B", "build_ffi.py"], cwd=tree, capture_output=True, text=True
    )
    assert (process.returncode, process.stderr) == (0, "")
    assert {path: path.read_bytes() for path in tree.rglob("*") if path.is_file()} == before


@pytest.fixture
def image(tmp_path: Path) -> Path:
    """Return the folder that deploy/Dockerfile installs, with the files that it copies."""
    text = (ROOT / "deploy" / "Dockerfile").read_text()
    for line in re.findall("^COPY (.*)$", text, re.MULTILINE):
        *names, into = line.split()
        for name in names:
            place = tmp_path / into.lstrip("/")
            if (ROOT / name).is_dir():
                shutil.copytree(ROOT / name, place, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                place.mkdir(exist_ok=True)
                shutil.copy(ROOT / name, place)
    (source,) = re.findall(r"pip install '/(\w+)\[nats,mqtt,influx\]'", text)
    return tmp_path / source


@pytest.mark.slow
def test_pip_builds_all_files_of_the_image_without_bytecode(image: Path, tmp_path: Path) -> None:
    """With the environment of nobody, where Python writes bytecode beside what it imports."""
    process = subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "--no-build-isolation",
         "--no-index", "--disable-pip-version-check", "-w", str(tmp_path), str(image)],
        env={"PATH": os.defpath, "HOME": str(tmp_path), "TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stdout + process.stderr
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    package = {str(path.relative_to(ROOT)) for path in (ROOT / "libmodbus_py").rglob("*.py")}
    examples = {path.name for path in (ROOT / "examples").iterdir() if path.is_file()}
    assert package - set(names) == set()
    assert examples - {name.rpartition("/")[2] for name in names if "/examples/" in name} == set()
    assert any(name.endswith("/libmodbus-py.1") for name in names)
    assert [name for name in names if "__pycache__" in name or name.endswith(".pyc")] == []


def test_compose_files_build_the_image_of_the_tree() -> None:
    """Of the whole repository, and not of deploy/ alone."""
    compose = (ROOT / "deploy" / "compose.yaml").read_text()
    assert "    build:\n      context: ..\n      dockerfile: deploy/Dockerfile\n" in compose


@pytest.mark.skipif(shutil.which("musl-gcc") is None, reason="musl-gcc is not installed")
@each_case("source", ["scan", "answer_chunk", "_libmodbus"])
def test_musl_compiles_all_c(tmp_path: Path, source: str) -> None:
    (tmp_path / "modbus").mkdir(exist_ok=True)
    for header in Path("/usr/include/modbus").glob("*.h"):
        shutil.copy(header, tmp_path / "modbus")
    if source == "scan":
        text = loaded(ROOT / "build_ffi.py").scan._assigned_source[1]
    else:
        text = (BINDING / f"{source}.c").read_text()
    process = subprocess.run(
        ["musl-gcc", "-fsyntax-only", f"-I{tmp_path}", "-Wall", "-x", "c", "-"],
        input=text,
        capture_output=True,
        text=True,
    )
    assert process.returncode == 0, process.stderr


# Of those who work on this package.
NOT_FOR_USERS = {"test", "docs", "lint", "bench", "fuzz", "mutants", "wheel"}


def test_the_table_of_extras_is_that_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    table = {
        name: extra[0]  # without a marker, with which pip would install nothing without a word
        for name, extra in project["optional-dependencies"].items()
        if name not in NOT_FOR_USERS
    }
    assert {name: requirement for name, (requirement, _) in EXTRAS.items()} == table


def test_debian_suggests_and_the_documents_name_each_package() -> None:
    control = (ROOT / "packaging" / "debian" / "control").read_text()
    page = (ROOT / "docs" / "how-to" / "install.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\| (?:`([\w-]+)`|-) \|$", page, re.MULTILINE))
    assert rows == {name: package for name, (_, package) in EXTRAS.items()}
    for _, package in EXTRAS.values():
        assert package in control


@pytest.mark.parametrize(
    ("place", "extra", "command"),
    [
        ("/venv/lib/site-packages", "mqtt", f"{sys.executable} -m pip install 'aiomqtt>=2.3'"),
        ("/usr/lib/python3/dist-packages", "influx", "sudo apt install python3-httpx"),
        (
            "/usr/lib/python3/dist-packages",
            "nats",
            "python3 -m venv --system-site-packages VENV && VENV/bin/pip install 'nats-py>=2.16'",
        ),
    ],
)
def test_a_hint_fits_the_installation(place, extra, command, monkeypatch) -> None:
    monkeypatch.setattr("libmodbus_py.version.__file__", f"{place}/libmodbus_py/version.py")
    assert how_to_add(extra) == command


BASH = ROOT / "packaging" / "shared" / "libmodbus-py"


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("man") / "libmodbus-py.1"
    environment = os.environ | {"PYTHONPATH": str(ROOT), "SOURCE_DATE_EPOCH": "1700000000"}
    subprocess.run(
        [sys.executable, ROOT / "packaging" / "man.py", path], env=environment, check=True
    )
    return path


def test_the_manual_page_contains_the_help_of_every_command(page: Path) -> None:
    text = page.read_text()
    assert text.startswith('.TH LIBMODBUS-PY 1 "2023-11-14" "libmodbus-py ')
    for name in COMMANDS:
        assert f"\n.SH {name.upper()}\n.EX\nusage: libmodbus\\-py {name} " in text
    assert "\\-\\-watch" in text


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_finds_no_mistake_in_the_manual_page(page: Path) -> None:
    process = subprocess.run(
        ["man", "--warnings", "-l", str(page)],
        env=os.environ | {"MANWIDTH": "100", "LC_ALL": "C.UTF-8"},
        capture_output=True,
        text=True,
    )
    assert (process.returncode, process.stderr) == (0, "")
    for text in ("libmodbus-py read", "--watch", "libmodbus-py diagnose", "'"):
        assert text in process.stdout


@pytest.mark.parametrize(("typed", "words"), [("dia", ["diagnose"]), ("ga", ["gateway"])])
def test_the_installed_script_completes_in_bash(typed, words, tmp_path) -> None:
    pytest.importorskip("argcomplete")
    program = tmp_path / "libmodbus-py"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m libmodbus_py "$@"\n')
    program.chmod(0o755)
    line = f"libmodbus-py {typed}"
    script = f"source {BASH}; COMP_LINE='{line}'; COMP_POINT={len(line)}; COMP_TYPE=9;"
    script += "_libmodbus_py libmodbus-py; printf '%s\\n' \"${COMPREPLY[@]}\""
    path = f"{tmp_path}{os.pathsep}{os.environ['PATH']}"
    environment = os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}
    process = subprocess.run(
        ["bash", "--norc", "-c", script], env=environment, capture_output=True, text=True
    )
    assert process.stderr == ""
    assert [line.strip() for line in process.stdout.splitlines()] == words
