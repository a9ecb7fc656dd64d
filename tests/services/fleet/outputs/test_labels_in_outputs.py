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

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.line_file import CsvOutput, JsonOutput
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.workers.messages import _messages
from tests.support.cases import each_case
from tests.support.outputs import write

ODD = {"site": 'Halle "2", Tor\\', "line": "ü"}

LABELS: Mapping[str, Mapping[str, str]] = {"north": ODD, "south": {}}

POINTS = RegisterMap([Point("level", "holding_registers", 0)])


def reading(device: str, labels: Mapping[str, str] | None = None) -> Reading:
    labels = LABELS.get(device, {}) if labels is None else labels
    return Reading(100.0, device, "level", 7, "m", "good", labels=labels)


def described(**labels: Mapping[str, str]) -> dict[str, DeviceConfig]:
    return {
        name: DeviceConfig(name, "tcp://127.0.0.1", POINTS, labels=each)
        for name, each in labels.items()
    }


def written(output: Any, path: Path, *devices: str | Reading) -> str:
    readings = [reading(each) if isinstance(each, str) else each for each in devices]
    asyncio.run(write(output, readings))
    return path.read_text()


def test_json_holds_them(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    output = JsonOutput(str(path))
    north, south, other = map(json.loads, written(output, path, *LABELS, "other").splitlines())
    assert north["labels"] == ODD
    assert "labels" not in south
    assert "labels" not in other


def test_csv_has_a_column_for_each_that_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rows"
    output = CsvOutput(str(path), labels=["line", "place", "site"])
    head, *rows = csv.reader(written(output, path, *LABELS, "other").splitlines(), strict=True)
    assert head[-4:] == ["reason", "line", "place", "site"]
    assert [row[-3:] for row in rows] == [["ü", "", ODD["site"]], ["", "", ""], ["", "", ""]]
    assert {len(row) for row in rows} == {len(head)}


def test_a_message_of_nats_holds_them_once() -> None:
    two = [reading("north"), reading("north")._replace(name="flow"), reading("south")]
    north, south = (json.loads(data) for _, _, data in _messages(two, 10_000))
    assert north["labels"] == ODD
    assert "labels" not in south
    assert "labels" not in north["values"]["level"]


@pytest.mark.parametrize("payload", ["point", "poll"])
def test_a_message_of_mqtt_holds_them(payload: str) -> None:
    topic = "plant/{device}/{name}" if payload == "point" else "plant/{device}"
    output = Mqtt("mqtt://127.0.0.1", topic=topic, status="")
    messages = output._messages.of([reading(each) for each in (*LABELS, "other")])
    north, south, other = (json.loads(data) for _, data in messages)
    assert north["labels"] == ODD
    assert "labels" not in south
    assert "labels" not in other


KINDS: dict[str, Callable[[str], Any]] = {
    "json": JsonOutput,
    "csv": lambda path: CsvOutput(path, labels=["site"]),
    "influx": Influx,
}


@pytest.mark.parametrize("kind", KINDS)
def test_readings_that_waited_have_the_labels_of_their_time(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "readings"
    output = KINDS[kind](str(path))
    if isinstance(output, Influx):
        output.describe(described(north={"site": "Halle"}))
        output.describe(described(north={"site": "Hof"}))
        output.describe({})
    waited = [reading("north", {"site": "Halle"}), reading("north", {"site": "Hof"})]
    lines = written(output, path, *[waited[0], waited[1]._replace(time=101.0)]).splitlines()
    assert "Halle" in lines[-2]
    assert "Hof" in lines[-1]


@pytest.mark.parametrize("topic", ["{label.site}/{device}/{name}", "{label.site}/{device}"])
def test_topics_have_the_labels_of_the_time_of_a_reading(topic: str) -> None:
    output = Mqtt("mqtt://127.0.0.1", topic=topic, status="")
    output.describe(described(north={"site": "Hof"}))
    output.describe({})
    topics = [at for at, _ in output._messages.of([reading("north", {"site": "Halle"})])]
    assert topics[0].startswith("Halle/north")


@pytest.mark.parametrize("topic", ["{label.site}/{device}/{name}", "{label.site}/{device}"])
def test_a_former_topic_is_taken_back_until_that_was_accepted(topic: str) -> None:
    messages = Mqtt("mqtt://127.0.0.1", topic=topic, status="")._messages
    sites = [reading("north", {"site": site}) for site in ("x", "y", "z")]
    moved = [sites[1], sites[2]._replace(time=101.0)]
    list(messages.of(sites[:1]))
    messages.keep()
    for _ in range(2):  # the connection is lost during the first write
        sent = [(at.partition("/")[0], b'"offline"' in data) for at, data in messages.of(moved)]
        assert sent == [("x", True), ("y", False), ("y", True), ("z", False)]
    messages.keep()
    assert [at.partition("/")[0] for at, _ in messages.of(moved[1:])] == ["z"]


def test_points_with_states_stay_text_when_their_device_is_removed(tmp_path: Path) -> None:
    path = tmp_path / "lines"
    output = Influx(str(path))
    states = RegisterMap([Point("level", "holding_registers", 0, states={1: "open"})])
    output.describe({"north": DeviceConfig("north", "tcp://127.0.0.1", states)})
    output.describe({})
    assert 'level="7"' in written(output, path, "north")


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
