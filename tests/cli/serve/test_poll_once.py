"""
poll --once: it ends with 1 if an output has not taken all readings.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.commands import ended

FLEET = """
[[device]]
name = "one"
url = "{url}"
[[device.point]]
name = "volts"
table = "holding_registers"
address = 0
[[device.point]]
name = "amperes"
table = "holding_registers"
address = 1
"""


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Path]:
    with ServerMaker() as maker:
        path = tmp_path / "fleet.toml"
        path.write_text(FLEET.format(url=maker().url))
        yield path


def test_an_output_that_takes_nothing(fleet: Path) -> None:
    done = ended("poll", fleet, "--once", "--json", "/nowhere/at/all", "--csv")
    assert done.code == 1
    assert "json /nowhere/at/all: 2 readings lost: /nowhere/at/all: No such file" in done.err
    assert done.out.count("\n") == 3  # the other output got all


def test_nothing_is_lost(fleet: Path) -> None:
    path = fleet.with_name("readings.jsonl")
    done = ended("poll", fleet, "--once", "--json", path)
    assert (done.code, done.err) == (0, "")
    assert [json.loads(line)["name"] for line in path.read_text().splitlines()] == [
        "volts",
        "amperes",
    ]


def test_an_output_that_takes_nothing_while_a_journal_keeps_all(fleet: Path) -> None:
    fleet.write_text(f'journal = "fleet.db"\n{fleet.read_text()}')
    done = ended("poll", fleet, "--once", "--json", "/nowhere/at/all")
    assert done.code == 1
    waiting = "json /nowhere/at/all: 2 readings wait in the journal: /nowhere/at/all: No such file"
    assert waiting in done.err
