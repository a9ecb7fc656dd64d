"""What is published: a tag that is the version, of which all tests passed."""

import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.support.cases import each_case

ROOT = Path(__file__).parents[2]
WORKFLOWS = ROOT / ".github" / "workflows"

FILES = ("pyproject.toml", "libmodbus_py/version.py", "packaging/debian/changelog")
VERSION = re.compile(r"(?m)^(version = \"|__version__ = \"|libmodbus-py \()\d+\.\d+\.\d+")


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return the files that are checked, of the version 1.2.3 and with an address."""
    for name in ("packaging/release.py", *FILES):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    for name in FILES:
        state(tmp_path / name, "1.2.3")
    project = tmp_path / "pyproject.toml"
    text = re.sub(r"(?ms)^\[project\.urls\]$.*?(?=^\[)", "", project.read_text())
    project.write_text(f'{text}\n[project.urls]\nSource = "https://forge.example/libmodbus-py"\n')
    return tmp_path


def state(file: Path, version: str) -> None:
    text, count = VERSION.subn(rf"\g<1>{version}", file.read_text(), count=1)
    assert count == 1
    file.write_text(text)


def answer(tree: Path, tag: str) -> tuple[int, str]:
    command = [sys.executable, str(tree / "packaging" / "release.py"), tag]
    process = subprocess.run(command, capture_output=True, text=True)
    return process.returncode, process.stdout + process.stderr


def test_a_tag_equals_the_version(tree: Path) -> None:
    assert answer(tree, "v1.2.3") == (0, "")
    for tag in ("v1.2.4", "1.2.3", "v1.2", "v1.2.3-1"):
        message = f"release: the tag is {tag}, but the version in pyproject.toml is 1.2.3\n"
        assert answer(tree, tag) == (1, message)


@each_case("name", FILES)
def test_a_file_with_an_older_version_is_named(tree: Path, name: str) -> None:
    state(tree / name, "1.2.2")
    message = f"release: the tag is v1.2.3, but the version in {name} is 1.2.2\n"
    assert answer(tree, "v1.2.3") == (1, message)
    state(tree / name, "1.2.3")


def test_without_a_public_address_nothing_is_published(tree: Path) -> None:
    project = tree / "pyproject.toml"
    project.write_text(project.read_text().replace("\nSource = ", "\nHomepage = "))
    message = "release: pyproject.toml has no [project.urls] Source, a public address\n"
    assert answer(tree, "v1.2.3") == (1, message)


NAME = "libmodbus-py"
BY_NAME = re.compile(r"\b(?:pip3?|pipx|uvx?|poetry)\b[^\n`&;|]*[\s'\"]libmodbus[-_]py(?![\w./*-])")


def installs_by_name(text: str) -> bool:
    return BY_NAME.search(text.replace("\\\n", " ")) is not None


def test_no_instruction_installs_a_package_that_is_not_published() -> None:
    """Whoever registers the name could put anything under it."""
    files = runpy.run_path(str(ROOT / "packaging" / "deb.py"))["files"]()
    assert len(files) > 500
    wrong = [name for name in files if installs_by_name((ROOT / name).read_text(errors="replace"))]
    assert wrong == []


def test_an_installation_by_name_is_distinguished_from_one_by_file() -> None:
    by_name = [
        f"pip install {NAME}",
        f"/opt/{NAME}/bin/pip install '{NAME}[nats]'",
        f"pip install \\\n    {NAME}",
        f"pip install --no-binary {NAME} {NAME}",
        f'[sys.executable, "-m", "pip", "install", "{NAME}"]',
        f"uvx {NAME} demo",
    ]
    of_files = [
        f"/opt/{NAME}/bin/pip install '/src[nats]'",
        f"pip install dist/{NAME}-*.whl",
        f"pip install . && {NAME} demo",
        f"`pip install .` installs {NAME}",
    ]
    assert [installs_by_name(text) for text in by_name + of_files] == [True] * 6 + [False] * 4


def jobs(workflow: str) -> dict[str, str]:
    """Return the jobs of a workflow by name, each as its lines."""
    text = (WORKFLOWS / workflow).read_text().partition("\njobs:\n")[2]
    parts = re.split(r"(?m)^  (\w+):$", text)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def test_publishing_waits_for_all_other_jobs() -> None:
    jobs_ = jobs("release.yml")
    (needs,) = re.findall(r"(?m)^    needs: \[(.*)\]$", jobs_["publish"])
    others = {"tag", "tests", "wheels", "sdist"}
    assert set(needs.split(", ")) == jobs_.keys() - {"publish"} == others
    # A condition with a function such as always() would not wait for their success.
    on_tags = "    if: startsWith(github.ref, 'refs/tags/v')\n"
    for name in ("publish", "tag", "tests"):
        assert re.findall(r"(?m)^ +if: .*\n", jobs_[name]) == [on_tags]
    assert not any("continue-on-error" in lines for lines in jobs_.values())


def test_a_release_runs_the_tests_of_a_change() -> None:
    jobs_ = jobs("release.yml")
    assert "    uses: ./.github/workflows/ci.yml\n" in jobs_["tests"]
    triggers = (WORKFLOWS / "ci.yml").read_text().partition("\non:\n")[2].partition("\n\n")[0]
    assert re.search(r"(?m)^  workflow_call:", triggers)
    assert '      - run: python3 packaging/release.py "$GITHUB_REF_NAME"\n' in jobs_["tag"]


def test_wheels_get_the_time_of_the_commit() -> None:
    """packaging/repair.py, which cibuildwheel calls, wants it."""
    steps = re.findall(r"(?m)^      - run: (.*)$", jobs("release.yml")["wheels"])
    dated, build = steps
    assert dated == 'echo "SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)" >> "$GITHUB_ENV"'
    assert "cibuildwheel" in build


def test_actions_are_pinned_by_hash() -> None:
    """A tag may be moved; a comment names the version, for people. Workflows here need none."""
    uses = [
        line.strip()
        for path in sorted(WORKFLOWS.glob("*.yml"))
        for line in path.read_text().splitlines()
        if "uses:" in line
    ]
    assert len(uses) >= 8
    pinned = re.compile(r"- uses: [\w./-]+@[0-9a-f]{40} # v\d+\.\d+\.\d+|uses: \./\S+")
    assert [line for line in uses if not pinned.fullmatch(line)] == []
