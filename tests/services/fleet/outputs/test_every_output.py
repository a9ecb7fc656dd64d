"""What each output promises of readings: their labels, those of their time, and their ids."""

import asyncio
import csv
import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.protocol.plain import text_of
from libmodbus_py.protocol.values import value_type
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.line_file import CsvOutput, JsonOutput
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.output import OutputError
from libmodbus_py.services.workers.messages import _messages
from libmodbus_py.tools.page.text import value_text
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.outputs import reading, write

POINTS = RegisterMap([Point("level", "holding_registers", 0)])

STATES = RegisterMap([Point("level", "holding_registers", 0, states={1: "open"})])


def described(points: RegisterMap = POINTS, **labels: Mapping[str, str]) -> dict[str, DeviceConfig]:
    return {
        name: DeviceConfig(name, "tcp://127.0.0.1", points, labels=label)
        for name, label in labels.items()
    }


def in_file(output: Any, path: Path, readings: Sequence[Reading]) -> list[str]:
    asyncio.run(write(output, readings))
    return path.read_text().splitlines()


def in_json(path: Path, readings: Sequence[Reading]) -> list[str]:
    return in_file(JsonOutput(str(path)), path, readings)


def in_csv(path: Path, readings: Sequence[Reading]) -> list[str]:
    return in_file(CsvOutput(str(path), labels=["line", "place", "site"]), path, readings)[1:]


def in_lines(path: Path, readings: Sequence[Reading]) -> list[str]:
    output = Influx(str(path))
    # Neither a label of now nor a device that was removed changes what is known of a reading.
    output.describe_devices(described(north={"site": "Hof"}))
    output.describe_devices({})
    return in_file(output, path, readings)


def in_mqtt(topic: str, readings: Sequence[Reading]) -> list[str]:
    output = Mqtt("mqtt://127.0.0.1", topic=topic, status="")
    output.describe_devices(described(north={"site": "Hof"}))
    output.describe_devices({})
    return [f"{at} {data.decode()}" for at, data, *_ in output._messages.of(readings)]


def in_nats(path: Path, readings: Sequence[Reading]) -> list[str]:
    return [data.decode() for _, _, data in _messages(readings, 10_000)]


Written = Callable[[Path, Sequence[Reading]], list[str]]

EVERY: dict[str, Written] = {
    "json": in_json,
    "csv": in_csv,
    "influx": in_lines,
    "mqtt, a point": lambda _, readings: in_mqtt("{label.site}/{device}/{name}", readings),
    "mqtt, a poll": lambda _, readings: in_mqtt("{label.site}/{device}", readings),
    "nats": in_nats,
}


@pytest.mark.parametrize("kind", EVERY)
def test_readings_have_the_labels_of_their_time(kind: str, tmp_path: Path) -> None:
    """They waited meanwhile, and one device has none."""
    waited = [
        reading("north", "level", 7, 100.0 + at)._replace(labels={"site": site})
        for at, site in enumerate(["Halle", "Tor"])
    ]
    *former, south = EVERY[kind](tmp_path / "readings", [*waited, reading("south", "level", 7)])
    # At the former topic of MQTT, a reading without value follows.
    first, last = former[0], former[-1]
    assert "Halle" in first
    assert "Tor" in last
    assert not any("Hof" in entry for entry in former)
    assert not any(entry in south for entry in ("Halle", "Tor", "Hof", '"labels"'))


ODD = {"site": 'Halle "2", Tor\\', "line": "ü"}


@each_case("kind", [kind for kind in EVERY if kind not in ("csv", "influx")])
def test_labels_in_json_are_one_object(kind: str, tmp_path: Path) -> None:
    path = tmp_path / kind
    lines = EVERY[kind](path, [reading("north", "level")._replace(labels=ODD)])
    row = json.loads(lines[0][lines[0].index("{") :])
    assert row["labels"] == ODD
    assert "labels" not in str(row.get("values", ""))


def test_csv_has_a_column_for_each_label_that_is_named(tmp_path: Path) -> None:
    path = tmp_path / "rows"
    rows = in_csv(path, [reading("north", "level")._replace(labels=ODD), reading("south", "level")])
    assert path.read_text().splitlines()[0].endswith(",reason,line,place,site")
    assert [row[-3:] for row in csv.reader(rows, strict=True)] == [["ü", "", ODD["site"]], [""] * 3]


@each_case("kind", [kind for kind in EVERY if kind not in ("csv", "influx")])
@each_case("number", [0, 17])
def test_json_has_the_id_of_a_reading_that_has_one(kind: str, number: int, tmp_path: Path) -> None:
    """Readings have ids from a journal."""
    (tmp_path / kind).unlink(missing_ok=True)
    (line,) = EVERY[kind](tmp_path / kind, [reading("a", "level")._replace(id=number)])
    row = json.loads(line[line.index("{") :])
    assert row.get("values", {"level": row})["level"].get("id", 0) == number
    assert ("id" in line) is bool(number)


@pytest.mark.parametrize("topic", ["{label.site}/{device}/{name}", "{label.site}/{device}"])
def test_a_former_topic_is_cleared_until_the_broker_accepted_that(topic: str) -> None:
    messages = Mqtt("mqtt://127.0.0.1", topic=topic, status="")._messages
    sites = [reading("north", "level")._replace(labels={"site": site}) for site in ("x", "y", "z")]
    moved = [sites[1], sites[2]._replace(time=101.0)]
    list(messages.of(sites[:1]))
    messages.keep_readings()
    for _ in range(2):  # the connection is lost during the first write
        rows = [(at.partition("/")[0], b'"offline"' in data) for at, data, *_ in messages.of(moved)]
        assert rows == [("x", True), ("y", False), ("y", True), ("z", False)]
    messages.keep_readings()
    assert [at.partition("/")[0] for at, *_ in messages.of(moved[1:])] == ["z"]


def test_points_with_states_stay_text_when_their_device_is_removed(tmp_path: Path) -> None:
    output = Influx(str(tmp_path / "lines"))
    output.describe_devices(described(STATES, north={}))
    output.describe_devices({})
    (line,) = in_file(output, tmp_path / "lines", [reading("north", "level", 7)])
    assert 'level="7"' in line


def test_bad_columns_are_refused(refused: Refused) -> None:
    refused("wrong_columns.txt", lambda labels: CsvOutput(labels=labels))


@pytest.mark.parametrize(
    ("output", "package", "message"),
    [
        (Influx(url="http://192.0.2.1", database="plant"), "httpx", "InfluxDB needs httpx: "),
        (Mqtt("mqtt://192.0.2.1"), "aiomqtt", "MQTT needs aiomqtt: "),
    ],
)
def test_without_its_package_one_line_says_what_to_install(output, package, message, monkeypatch):
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(OutputError, match=message):
        asyncio.run(output.open_output())


NUMBERS = [
    ("uint16", 0.1, [2301], "230.1"),
    ("int16", 0.01, [0xFFFF], "-0.01"),
    ("uint32", 0.001, [1, 0], "65.536"),
    ("int32", 1, [0xFFFF, 0xFFFE], "-2"),
    ("uint64", 1, [0x7FFF, 0xFFFF, 0xFFFF, 0xFFFF], "9223372036854775807"),
    ("int48", 0.1, [0, 0, 3], "0.3"),
    ("bcd32", 0.01, [0x0012, 0x3456], "1234.56"),
    ("float16", 1, [0x5B31], "230.1"),
    ("float32", 1, [0x4366, 0x199A], "230.1"),
    ("float32", 0.1, [0x4366, 0x199A], "23.01"),
    ("float64", 1, [0x406C, 0xC333, 0x3333, 0x3333], "230.1"),
]


@each_case(("type", "scale", "cells", "text"), NUMBERS)
def test_a_number_has_the_same_digits_in_each_output_on_the_page_and_in_read(
    tmp_path: Path, type: Any, scale: float, cells: list[int], text: str
) -> None:
    point = Point("level", "holding_registers", 0, type=type, scale=scale)
    value = point.decode(cells)
    assert text_of(value, value_type(type)) == text
    assert value_text(value) == text
    one = reading("north", "level", value)
    for name, save in EVERY.items():
        *_, line = save(tmp_path / name.replace(" ", ""), [one])
        numbers = re.findall(r"(?<![\w.-])-?[0-9]+(?:\.[0-9]+)?", line)
        assert text in numbers, (name, line)
