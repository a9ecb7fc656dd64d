"""
The command map from-sunspec: the map that it writes reads the same values as discovery.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py import Client, load_map, sunspec
from tests.support.commands import run
from tests.support.sunspec import file_device, serving


@pytest.mark.parametrize("suffix", ["toml", "csv"])
def test_the_map_has_the_points_that_are_discovered(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"inverter.{suffix}"
    with serving(file_device("device_1547.json")) as url:
        done = run("map", "from-sunspec", url, "-o", str(path))
        assert (done.code, done.err) == (0, f"{path}: 415 points\n")
        with Client(url) as plc:
            found = sunspec.discover(plc).map
            assert plc.read_map(load_map(path)) == plc.read_map(found)
    assert dict(load_map(path)) == dict(found)
    assert run("map", "from-sunspec", url, "-o", str(path)).code == 2
