"""
Register maps that come with the package, by their names in device files and fleet files.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import device_file, load_map
from libmodbus_py.fleet import load
from libmodbus_py.tools.simulator.example_files import map_file

FLEET = '[[device]]\nname = "a"\nurl = "tcp://127.0.0.1"\nmap = "{name}"\n'

DEVICE = '[[unit]]\nid = 1\nmap = "{name}"\n'

FORMS: dict[str, tuple[str, Callable[[Path], Any]]] = {
    "fleet file": (FLEET, lambda path: load(path).devices[0].map),
    "device file": (DEVICE, lambda path: device_file.load(path).devices[1].points),
    "list of devices": ('devices = "list.csv"\n', lambda path: load(path).devices[0].map),
}


def written(form: str, name: str, folder: Path) -> Path:
    path = folder / "file.toml"
    path.write_text(FORMS[form][0].replace("{name}", name))
    (folder / "list.csv").write_text(f"name,url,map\na,tcp://127.0.0.1,{name}\n")
    return path


@pytest.mark.parametrize("form", FORMS)
def test_a_name_is_that_of_a_map_of_the_package(form: str, tmp_path: Path) -> None:
    found = FORMS[form][1](written(form, "sdm120", tmp_path))
    assert set(found) == set(load_map(map_file("sdm120")))


@pytest.mark.parametrize("form", FORMS)
def test_a_file_is_meant_by_its_ending(form: str, tmp_path: Path) -> None:
    (tmp_path / "sdm120.csv").write_text("name,table,address\nown,holding_registers,7\n")
    assert set(FORMS[form][1](written(form, "sdm120.csv", tmp_path))) == {"own"}


@pytest.mark.parametrize("form", FORMS)
def test_another_name_is_refused_with_those_that_there_are(form: str, tmp_path: Path) -> None:
    said = r"'sdm12' is neither the path of a register map.* the examples are abb_b23, .*sdm120"
    with pytest.raises(ValueError, match=rf"{re.escape(str(tmp_path))}.*map: {said}"):
        FORMS[form][1](written(form, "sdm12", tmp_path))
