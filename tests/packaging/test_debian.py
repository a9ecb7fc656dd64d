"""What the Debian package consists of; packaging/deb.py builds it."""

import re
import runpy
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.support.cases import each_case

ROOT = Path(__file__).parents[2]
DEBIAN, DEPLOY = ROOT / "packaging" / "debian", ROOT / "deploy"
COMMANDS = ("serve", "gateway", "poll")

# What the templates say in other words than the units that they are made from.
OWN = ("Description", "ExecStart", "StateDirectory", "Environment")


def template(command: str) -> str:
    unit = (DEPLOY / f"libmodbus-py-{command}.service").read_text()
    process = subprocess.run(
        ["sh", DEBIAN / "template.sh", command], input=unit, capture_output=True, text=True
    )
    assert (process.returncode, process.stderr) == (0, "")
    return process.stdout


def test_the_debian_version_is_that_of_the_package() -> None:
    first = (DEBIAN / "changelog").read_text().splitlines()[0]
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.fullmatch(r"libmodbus-py \((.+)-\d+\) \w+; urgency=medium", first)[1] == version  # type: ignore[index]


def test_each_file_that_the_debian_package_names_exists() -> None:
    for name in (DEBIAN / "python3-libmodbus-py.docs").read_text().split():
        assert (ROOT / name).exists()
    rules = (DEBIAN / "rules").read_text()
    assert re.search(r"foreach command,(.*?),", rules)[1].split() == list(COMMANDS)  # type: ignore[index]
    assert (DEBIAN / "rules").stat().st_mode & 0o111
    project = (ROOT / "pyproject.toml").read_text()
    # What rules changes for the setuptools of Debian 12.
    assert 'license = "MIT"\n' in project
    assert project.count("\nlicense-files = ") == 1


files = runpy.run_path(str(ROOT / "packaging" / "deb.py"))["files"]

KNOWN = [".gitignore", "PKG-INFO", "docs/index.md", "libmodbus_py/binding/_libmodbus.c", "setup.py"]


def put(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def git(folder: Path, *command: str) -> None:
    own = ["-c", "user.name=N", "-c", "user.email=n@host.example"]
    subprocess.run(["git", *own, *command], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a folder that has the files of KNOWN."""
    place = tmp_path / "tree"
    put(place, *KNOWN)
    shutil.copy(ROOT / ".gitignore", place)
    return place


@pytest.fixture
def clone(tree: Path) -> Path:
    if shutil.which("git") is None:
        pytest.skip("git is not installed")
    git(tree, "init", "-q")
    git(tree, "add", ".")
    git(tree, "commit", "-q", "-m", "All")
    return tree


def test_an_unpacked_source_gives_all_files_but_generated_ones(tree: Path) -> None:
    lines = (ROOT / ".gitignore").read_text().replace("*", "x").split()
    rows = [f"{line.strip('/')}/in/it" if line.endswith("/") else line.strip("/") for line in lines]
    put(tree, *rows)
    put(tree, "venv/lib/x.py", ".venv/bin/pip", "build/lib/x.py", "libmodbus_py/__pycache__/x.pyc")
    put(tree, "libmodbus_py/binding/_libmodbus.abi3.so", "libmodbus_py.egg-info/PKG-INFO")
    assert files(tree) == KNOWN


def test_a_clone_gives_the_existing_files_that_git_knows(clone: Path, tmp_path):
    git(clone, "worktree", "add", "-q", str(tmp_path / "other"))
    git(clone, "update-index", "--add", "--cacheinfo", f"160000,{40 * '1'},submodule")
    put(clone, "new.py", "venv/lib/x.py", "submodule/x.py")
    (clone / "setup.py").unlink()
    assert files(clone) == KNOWN[:-1]
    put(tmp_path / "other", "new.py")
    assert files(tmp_path / "other") == KNOWN


def test_a_clone_may_belong_to_another_user(clone: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_TEST_ASSUME_DIFFERENT_OWNER", "1")
    assert files(clone) == KNOWN


def test_the_error_of_git_is_shown_if_it_knows_no_files(clone: Path, tmp_path: Path) -> None:
    shutil.rmtree(clone / ".git")
    (clone / ".git").write_text(f"gitdir: {tmp_path}/gone\n")
    with pytest.raises(SystemExit, match="deb: fatal: not a git repository"):
        files(clone)


@each_case("command", COMMANDS)
def test_a_template_is_as_hardened_as_its_unit(command: str) -> None:
    def lines(text: str) -> list[str]:
        return [
            line
            for line in text.splitlines()
            if "=" in line and not line.startswith(("#", *OWN, "Documentation"))
        ]

    unit = (DEPLOY / f"libmodbus-py-{command}.service").read_text()
    assert lines(template(command)) == lines(unit)
    assert f"ExecStart=/usr/bin/libmodbus-py {command} " in template(command)
    assert "/etc/libmodbus-py/%i.toml" in template(command)
    assert "/opt/" not in template(command)


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd is not installed")
@each_case("command", COMMANDS)
def test_systemd_accepts_a_template(command: str, tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("libmodbus-py")
    text = template(command).replace("/usr/bin/libmodbus-py", str(program))
    text = text.replace("Documentation=man:libmodbus-py(1)\n", "")
    (tmp_path / f"libmodbus-py-{command}@.service").write_text(text)
    instance = tmp_path / f"libmodbus-py-{command}@plant.service"
    instance.write_text(text)
    process = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(instance)], capture_output=True, text=True
    )
    complaints = [line for line in process.stderr.splitlines() if "libmodbus-py" in line]
    assert complaints == []


def test_commands_of_templates_have_valid_options(tmp_path: Path) -> None:
    from libmodbus_py.cli.commands import parse_arguments

    for command in COMMANDS:
        (start,) = re.findall("^ExecStart=(.*)$", template(command), re.MULTILINE)
        _, *words = start.replace("${URL}", "tcp://0.0.0.0:502").split()
        words = [word.replace("%i", "plant").replace("${STATE_DIRECTORY}", "/s") for word in words]
        options = parse_arguments(words)
        assert options.log == "info"
        assert getattr(options, "state", "/s/state.json") == "/s/state.json"
