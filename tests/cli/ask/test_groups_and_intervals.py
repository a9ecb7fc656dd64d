"""read of groups of a map, and --watch of points with intervals and of totals that fall."""

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Server, load_map
from libmodbus_py.device.hooks import Hook
from tests.support.commands import run

MAP = """\
name,table,address,group,interval,never_falls,unit
v,holding,0,fast,,,V
energy,holding,5,slow,,true,kWh
serial,holding,9,slow,3600,,
"""


class Meter:
    """A device that counts how often each register is read, and whose total falls."""

    def __init__(self, path: Path) -> None:
        self.asked: list[int] = []
        self.totals = [100, 3, 4]
        hook = Hook(self.note, holding_registers=[range(10)])
        self.device = Device.of_map(load_map(path), {"v": 230}, before_read=hook)

    def note(self, access: object) -> None:
        address = access.address  # type: ignore[attr-defined]
        self.asked.append(address)
        if address == 5:
            number = min(self.asked.count(5), len(self.totals))
            self.device.mapping.holding_registers[5] = self.totals[number - 1]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "meter.csv").write_text(MAP)
    return tmp_path / "meter.csv"


@pytest.fixture
def meter(path: Path) -> Meter:
    return Meter(path)


@pytest.fixture
def url(meter: Meter) -> Iterator[str]:
    with Server(meter.device).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


def test_a_group_is_read(meter: Meter, url: str, path: Path) -> None:
    output = json.loads(run("read", url, "--map", path, "--group", "fast", "--json").out)
    assert output["values"] == {"v": 230}
    assert meter.asked == [0]
    more = run("read", url, "--map", path, "--group", "slow", "--group", "fast", "--json")
    assert set(json.loads(more.out)["values"]) == {"v", "energy", "serial"}
    with_name = run("read", url, "v", "--map", path, "--group", "slow", "--json")
    assert list(json.loads(with_name.out)["values"]) == ["energy", "serial", "v"]


def test_points_are_watched_at_their_intervals(meter: Meter, url: str, path: Path) -> None:
    lines = run("read", url, "--map", path, "--watch", "0.01", "--count", "3", "--json").out
    rows = [json.loads(line) for line in lines.splitlines()]
    assert meter.asked.count(0) == 3
    assert meter.asked.count(9) == 1
    assert [row["values"]["serial"] for row in rows] == [0, 0, 0]
    # The second total was smaller, was read again at once, and still was.
    assert [row["values"]["energy"] for row in rows] == [100, 4, 4]
    assert [row.get("fell") for row in rows] == [None, ["energy"], None]


def test_text_and_csv_mark_a_total_that_fell(meter: Meter, url: str, path: Path) -> None:
    watch = ("--watch", "0.01", "--count", "2")
    lines = run("read", url, "energy", "--map", path, *watch).out.splitlines()
    assert [line.partition("  ")[2] for line in lines] == ["energy=100 kWh", "energy=4 kWh (fell)"]
    meter.asked.clear()
    rows = list(
        csv.reader(run("read", url, "energy", "--map", path, *watch, "--csv").out.splitlines())
    )
    assert [row[1:] for row in rows[1:]] == [["100", ""], ["4", "energy is smaller than before"]]
