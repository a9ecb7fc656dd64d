"""
The labels of devices in each output: keys of JSON, columns of CSV, tags, messages of NATS.
"""

from __future__ import annotations

import asyncio
import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.outputs.csv_output import CsvOutput
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.json_output import JsonOutput
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.workers.stream import Stream, _messages
from tests.services.fleet.fleets import meter, simulated
from tests.support.cases import each_case

ODD = {"site": 'Halle "2", Tor\\', "line": "ü"}

LABELS: Mapping[str, Mapping[str, str]] = {"north": ODD, "south": {}}

POINTS = RegisterMap([Point("level", "holding_registers", 0)])


def reading(device: str) -> Reading:
    return Reading(100.0, device, "level", 7, "m", "good")


def label(output: Any, labels: Mapping[str, Mapping[str, str]]) -> None:
    output.describe(
        {
            name: DeviceConfig(name, "tcp://127.0.0.1", POINTS, labels=each)
            for name, each in labels.items()
        }
    )


def written(output: Any, path: Path, *devices: str) -> str:
    async def go() -> None:
        await output.open()
        await output.write([reading(each) for each in devices])
        await output.close()

    asyncio.run(go())
    return path.read_text()


def test_json_holds_them(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    output = JsonOutput(str(path))
    label(output, LABELS)
    north, south, other = map(json.loads, written(output, path, *LABELS, "other").splitlines())
    assert north["labels"] == ODD
    assert "labels" not in south
    assert "labels" not in other


def test_csv_has_a_column_for_each_that_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rows"
    output = CsvOutput(str(path), labels=["line", "place", "site"])
    label(output, LABELS)
    head, *rows = csv.reader(written(output, path, *LABELS, "other").splitlines(), strict=True)
    assert head[-4:] == ["reason", "line", "place", "site"]
    assert [row[-3:] for row in rows] == [["ü", "", ODD["site"]], ["", "", ""], ["", "", ""]]
    assert {len(row) for row in rows} == {len(head)}


def test_a_message_of_nats_holds_them_once() -> None:
    output = Stream(None, {})
    label(output, LABELS)
    two = [reading("north"), reading("north")._replace(name="flow"), reading("south")]
    north, south = (
        json.loads(data) for _, _, data in _messages(two, 10_000, output._labels.by_device)
    )
    assert north["labels"] == ODD
    assert "labels" not in south
    assert "labels" not in north["values"]["level"]


@pytest.mark.parametrize("payload", ["point", "poll"])
def test_a_message_of_mqtt_holds_them(payload: str) -> None:
    topic = "plant/{device}/{name}" if payload == "point" else "plant/{device}"
    output = Mqtt("mqtt://127.0.0.1", topic=topic)
    label(output, LABELS)
    messages = output._messages.of([reading(each) for each in (*LABELS, "other")])
    north, south, other = (json.loads(data) for _, data in messages)
    assert north["labels"] == ODD
    assert "labels" not in south
    assert "labels" not in other


def test_a_message_of_nats_stays_within_its_size() -> None:
    labels = {"north": {"site": "x" * 500}}
    many = [reading("north")._replace(name=f"p{number}") for number in range(100)]
    messages = list(_messages(many, 2000, labels))
    assert max(len(data) for _, _, data in messages) <= 2000
    assert sum(len(json.loads(data)["values"]) for _, _, data in messages) == 100


KINDS: dict[str, Callable[[str], Any]] = {
    "json": JsonOutput,
    "csv": lambda path: CsvOutput(path, labels=["site"]),
    "influx": Influx,
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_last_readings_of_a_removed_device_have_them(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "readings"
    output = KINDS[kind](str(path))
    label(output, {"north": {"site": "Halle"}})
    label(output, {"south": {"site": "Hof"}})
    assert "Halle" in written(output, path, "north")
    label(output, {"south": {"site": "Tor"}})
    assert "Halle" not in written(output, path, "north").splitlines()[-1]
    assert "Tor" in written(output, path, "south").splitlines()[-1]


@each_case(
    ("labels", "told"),
    [
        ("site", "labels must be a list"),
        ([1], r"labels\[0\] must be text"),
        ([""], r"labels\[0\] must be text"),
        (["time"], r"labels\[0\]: there is a column 'time' already"),
        (["site", "site"], r"labels\[1\]: there is a column 'site' already"),
    ],
)
def test_bad_columns_are_refused(labels: Any, told: str) -> None:
    with pytest.raises((TypeError, ValueError), match=told):
        CsvOutput(labels=labels)


def test_fleets_pass_them_to_outputs(tmp_path: Path) -> None:
    path = tmp_path / "lines"

    async def go() -> None:
        with Server({1: simulated()}).background("tcp://127.0.0.1:0") as served:
            devices = [meter("north", served.urls[0], labels=ODD)]
            await Fleet(devices, outputs=[JsonOutput(str(path))]).run(once=True)

    asyncio.run(go())
    assert {json.loads(line)["labels"]["line"] for line in path.read_text().splitlines()} == {"ü"}
