"""What extras need: the same in pyproject.toml, hints, the Debian package and the documents."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from libmodbus_py.protocol import extras
from libmodbus_py.protocol.extras import EXTRAS, how_to_add

ROOT = Path(__file__).parents[2]

# Of those who work on this package.
NOT_FOR_USERS = {"test", "docs", "lint", "bench", "fuzz", "wheel"}


def test_the_table_is_that_of_the_project() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {
        name: needed[0]  # without a marker, with which pip would install nothing without a word
        for name, needed in project["optional-dependencies"].items()
        if name not in NOT_FOR_USERS
    }
    assert {name: extra.requirement for name, extra in EXTRAS.items()} == wanted


def test_debian_suggests_and_the_documents_name_each_package() -> None:
    control = (ROOT / "packaging" / "debian" / "control").read_text()
    page = (ROOT / "docs" / "how-to" / "install.md").read_text()
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\| (?:`([\w-]+)`|-) \|$", page, re.MULTILINE))
    assert rows == {name: extra.package for name, extra in EXTRAS.items()}
    for extra in EXTRAS.values():
        assert extra.package in control


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
def test_a_hint_fits_the_installation(
    place: str, extra: str, command: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(extras, "__file__", f"{place}/libmodbus_py/protocol/extras.py")
    assert how_to_add(extra) == command
