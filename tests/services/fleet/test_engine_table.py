"""
The table [engine] of fleet files, which is checked with and without an engine.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from libmodbus_py.services.fleet.config import ENGINE
from libmodbus_py.services.fleet.files import FleetFileError, load
from libmodbus_py.services.workers.records import FleetSettings
from tests.support.cases import each_case
from tests.support.commands import run

DEVICE = """
[[device]]
name = "a"
url = "tcp://127.0.0.1:1"
[[device.point]]
name = "x"
table = "coils"
address = 0
"""


def settings(given: dict[str, Any]) -> FleetSettings:
    return FleetSettings(**ENGINE.read(("engine",), given))


def test_usual_settings() -> None:
    assert settings({}) == FleetSettings(10.0, "stop", False, 86_400.0, 1 << 30)


def test_all_of_them(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(
        "[engine]\nlease = 0.5\non_engine_loss = 'continue'\ncommands = true\n"
        f"max_age = 60\nmax_bytes = 65536\n{DEVICE}"
    )
    made = FleetSettings(**load(path).engine)
    assert made == FleetSettings(0.5, "continue", True, 60.0, 1 << 16)


@each_case("lease", [0.5, 60])
def test_the_shortest_and_the_longest_lease(lease: float) -> None:
    assert settings({"lease": lease}).lease == lease


@each_case(
    ("given", "error", "text"),
    [
        ({"leese": 1}, ValueError, "engine.leese: no such key; .*; did you mean lease\\?"),
        ({"lease": 0.4}, ValueError, "engine.lease must be in 0.5..60 seconds, not 0.4"),
        ({"lease": 61}, ValueError, "engine.lease must be in 0.5..60 seconds, not 61"),
        ({"lease": "1"}, TypeError, "engine.lease must be a number of seconds, not str"),
        ({"on_engine_loss": "wait"}, ValueError, "must be one of stop, continue, not 'wait'"),
        ({"commands": 1}, TypeError, "engine.commands must be true or false, not 1"),
        ({"max_age": 0}, ValueError, "engine.max_age must be in"),
        ({"max_bytes": 65535}, ValueError, "engine.max_bytes must be in 65536..1125899906842624"),
        ("nats://127.0.0.1", TypeError, "engine must be a table"),
    ],
)
def test_what_is_wrong_is_named(given: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        settings(given)


def test_a_file_with_a_wrong_key_is_refused_on_one_machine_too(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(f"[engine]\nleese = 3\n{DEVICE}")
    with pytest.raises(FleetFileError, match=r"line 2: engine\.leese: no such key"):
        load(path)
    assert run("poll", path, "--once").code == 2
