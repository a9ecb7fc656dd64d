"""What the Debian package consists of; packaging/deb.py builds it."""

from __future__ import annotations

import re
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
    done = subprocess.run(
        ["sh", DEBIAN / "template.sh", command], input=unit, capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def test_its_version_is_that_of_the_package() -> None:
    first = (DEBIAN / "changelog").read_text().splitlines()[0]
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert re.fullmatch(r"libmodbus-py \((.+)-\d+\) \w+; urgency=medium", first)[1] == version  # type: ignore[index]


def test_the_files_that_it_names_exist() -> None:
    for name in (DEBIAN / "python3-libmodbus-py.docs").read_text().split():
        assert (ROOT / name).exists()
    rules = (DEBIAN / "rules").read_text()
    assert re.search(r"foreach command,(.*?),", rules)[1].split() == list(COMMANDS)  # type: ignore[index]
    assert (DEBIAN / "rules").stat().st_mode & 0o111
    project = (ROOT / "pyproject.toml").read_text()
    # What rules changes for the setuptools of Debian 12.
    assert 'license = "MIT"\n' in project
    assert project.count("\nlicense-files = ") == 1


@each_case("command", COMMANDS)
def test_a_template_is_as_hardened_as_the_unit_that_it_is_made_from(command: str) -> None:
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
def test_systemd_takes_a_template(command: str, tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("libmodbus-py")
    text = template(command).replace("/usr/bin/libmodbus-py", str(program))
    text = text.replace("Documentation=man:libmodbus-py(1)\n", "")
    (tmp_path / f"libmodbus-py-{command}@.service").write_text(text)
    instance = tmp_path / f"libmodbus-py-{command}@plant.service"
    instance.write_text(text)
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(instance)], capture_output=True, text=True
    )
    said = [line for line in done.stderr.splitlines() if "libmodbus-py" in line]
    assert said == []


def test_a_command_of_the_templates_takes_its_words(tmp_path: Path) -> None:
    from libmodbus_py.cli.commands import parsed

    for command in COMMANDS:
        (start,) = re.findall("^ExecStart=(.*)$", template(command), re.MULTILINE)
        _, *words = start.replace("${URL}", "tcp://0.0.0.0:502").split()
        words = [word.replace("%i", "plant").replace("${STATE_DIRECTORY}", "/s") for word in words]
        given = parsed(words)
        assert given.log == "info"
        assert getattr(given, "state", "/s/state.json") == "/s/state.json"
