"""What stands in the bucket and in the stream of workers."""

import json
from typing import Any, cast

import pytest

from libmodbus_py.services.fleet.readings import Reading
from libmodbus_py.services.workers.messages import Stream
from libmodbus_py.services.workers.records import (
    SETTINGS,
    Connection,
    FleetSettings,
    Holding,
    Member,
    RecordError,
    Slot,
    decode,
    digest_of,
)
from tests.services.workers.trial import LEASE, Trial, on_trial
from tests.simulation.engine import Engine, EngineClient, with_engine
from tests.support.golden import Refused

LINE = "serial:/dev/ttyUSB0"
DIGEST = digest_of(LINE)


def value(**keys: Any) -> bytes:
    return json.dumps(keys).encode()


def line(connection: str = LINE, timeout: float = 1) -> bytes:
    return value(connection=connection, timeout=timeout, devices=[])


@pytest.mark.parametrize(
    ("key", "record"),
    [
        (SETTINGS, FleetSettings()),
        (SETTINGS, FleetSettings(0.5, "continue", True, 60.0, 1 << 16)),
        (SETTINGS, FleetSettings(60.0)),
        (f"connection._.{DIGEST}", Connection("", LINE, 0.0, '{"devices": []}')),
        (f"connection.north.{DIGEST}", Connection("north", LINE, 60.0, '{"devices": [{"a": 1}]}')),
        ("worker.a.1", Member("a.1", "here", ("", "north"), 10.0, 3, 17, {"up": 1})),
        ("worker.a.1", Member("a.1", "ended", (), 0.5)),
        ("slot.north.0", Holding(Slot("north", 0), "a.1", "b.2")),
        ("slot._.255", Holding(Slot("", 255), "a.1", "b.2")),
    ],
)
def test_records_are_read_as_they_were_written(key: str, record: Any) -> None:
    assert decode(key, record.encode()) == record


def test_records_that_no_worker_wrote_are_refused(refused: Refused) -> None:
    refused("wrong_records.txt", lambda record: decode(*record))
    with pytest.raises(RecordError, match=r"settings: .*(recursion|Expecting value)"):
        decode("settings", b"[" * 10_000)  # Python 3.14 reads it to its end


KEY = "tcp:192.0.2.99:502"


@pytest.mark.parametrize(
    "devices",
    [[], 7, {}, {"devices": 7}, {"devices": [7, None, {"name": {}}], "maps": []}],
    ids=str,
)
@on_trial(2, settings=FleetSettings(LEASE, commands=True))
async def test_invalid_devices_in_a_record_affect_no_answer_and_no_poll(trial: Trial, devices):
    await trial.start("a", "b")
    await trial.settle()
    value = {"connection": KEY, "timeout": 0.1, "devices": devices}
    trial.engine.write(f"connection._.{digest_of(KEY)}", json.dumps(value).encode())
    await trial.settle()
    client = trial.engine.client()
    answer = await client.request("modbus.write.nobody.setpoint", b"20", timeout=5)
    assert json.loads(answer.data)["error"] == "there is no device 'nobody'"
    await client.close()


def reading(name: str, value: Any, *, time: float = 100.0) -> Reading:
    return Reading(time, "kälte", name, value, "m", "good", "")


@with_engine
async def test_a_poll_is_one_message_and_a_repeated_one_is_dropped(
    engine: Engine, client: EngineClient
) -> None:
    stream = Stream(cast(Any, client), {})
    await stream.open_output()
    poll = [reading("level", 1.5), reading("höhe", 2)]
    await stream.write_readings(poll)
    await stream.write_readings([])
    await stream.write_readings([*poll, reading("level", 3, time=101.0)])
    first, second = (json.loads(data) for _, _, data in engine.stream)
    assert first["device"] == "kälte"
    assert {name: row["value"] for name, row in first["values"].items()} == {
        "level": 1.5,
        "höhe": 2,
    }
    assert {name: row["value"] for name, row in second["values"].items()} == {"level": 3}
    assert "kälte".encode() in engine.stream[0][2]
