"""
The stream of readings on a simulated server of NATS.
"""

import json
from typing import Any, cast

from libmodbus_py.services.fleet.readings import Reading
from libmodbus_py.services.workers.messages import Stream
from tests.simulation.engine import Engine, EngineClient, with_engine


def reading(name: str, value: Any, *, time: float = 100.0) -> Reading:
    return Reading(time, "kälte", name, value, "m", "good", "")


@with_engine
async def test_the_readings_of_a_poll_are_one_message_and_a_repeated_one_is_dropped(
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
    assert {name: each["value"] for name, each in first["values"].items()} == {
        "level": 1.5,
        "höhe": 2,
    }
    assert {name: each["value"] for name, each in second["values"].items()} == {"level": 3}
    assert "kälte".encode() in engine.stream[0][2]
