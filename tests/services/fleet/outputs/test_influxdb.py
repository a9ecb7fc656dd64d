"""InfluxDB itself, version 1 as Debian 12 has it: what it takes, and what it answers with."""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services import tasks
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.output import ReadingsRefused
from tests.services.fleet.outputs.influxdb import Database
from tests.support import outputs
from tests.support.programs import missing

pytestmark = pytest.mark.skipif(bool(missing("influxd")), reason="Debian 13 has no InfluxDB")


@pytest.fixture
def database(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Database]:
    monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(tasks, "LONGEST_PAUSE_S", 0.1)
    server = Database(tmp_path)
    server.start()
    yield server
    server.close()


def write(database: Database, *readings: Reading, **labels: str) -> None:
    points = RegisterMap([Point("state", "holding_registers", 0, states={0: "off"})])
    output = Influx(url=database.url, database="plant")
    names = {reading.device for reading in readings}
    output.describe_devices({name: DeviceConfig(name, "tcp://127.0.0.1", points) for name in names})
    asyncio.run(outputs.write(output, [reading._replace(labels=labels) for reading in readings]))


def reading(name: str, value: Any, time: float = 1_700_000_000.25, **keys: Any) -> Reading:
    return Reading(time, keys.pop("device", "north"), name, value, "m", "good", **keys)


def test_names_and_values_arrive_unchanged(database: Database) -> None:
    values = {
        "a b,c=d": 1,
        'quo"te': -2.5,
        "time": 3,
        "text": 'five" pipe\\ and more\n',
        "flag": True,
        "Füllstand": 1e300,
    }
    readings = [reading(name, value) for name, value in values.items()]
    write(database, *readings, site="a b,c=d\\", line="ü", area="")
    (row,) = database.ask("SELECT * FROM modbus")
    del values["time"]  # the key of all times
    assert row == {
        "time": "2023-11-14T22:13:20.25Z",
        "device": "north",
        "site": "a b,c=d%5C",
        "line": "ü",
        **values,
        "time_": 3,
        "text": 'five" pipe\\ and more\\x0a',
    }


def test_a_reading_sent_twice_is_stored_once(database: Database) -> None:
    for _ in range(2):
        write(database, reading("level", 1), reading("level", 2, 1_700_000_001.0))
    (row,) = database.ask("SELECT count(level) FROM modbus")
    assert row["count"] == 2


def test_integers_and_states_without_a_name_cause_no_conflict_of_types(database: Database) -> None:
    write(database, reading("level", 1), reading("state", "off"))
    write(database, reading("level", 1.5, 1_700_000_001.0), reading("state", 7, 1_700_000_001.0))
    rows = database.ask("SELECT level, state FROM modbus")
    assert [(row["level"], row["state"]) for row in rows] == [(1, "off"), (1.5, "7")]


def test_a_conflict_of_types_is_refused(database: Database) -> None:
    write(database, reading("level", 1))
    with pytest.raises(ReadingsRefused, match=r"400 .*conflict"):
        write(database, reading("level", "text", 1_700_000_001.0))
