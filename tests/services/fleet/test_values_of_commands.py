"""
Commands to points of every kind: numbers, states, bits and times, as JSON has them.
"""

from __future__ import annotations

import asyncio
import json
from datetime import UTC, datetime
from typing import Any

from libmodbus_py import Device, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig, Fleet
from libmodbus_py.services.fleet.commands import Commands, wanted_of
from libmodbus_py.services.fleet.outputs.forms import as_json
from libmodbus_py.services.fleet.readings import Reading
from tests.support.cases import each

H = "holding_registers"

MAP = RegisterMap(
    [
        Point("number", H, 0, scale=0.1),
        Point("state", H, 1, states={0: "off", 1: "on"}),
        Point("flags", H, 2, bits={0: "door", "4..7": "mode"}),
        Point("clock", H, 3, type="unix32"),
        Point("local", H, 5, type="date48", time_zone="Europe/Berlin"),
        Point("times", H, 8, type="unix32", count=2),
        Point("flag", H, 12, bit=3),
        Point("name", H, 13, type="string:4"),
        Point("scaled", H, 15, scale_from="sf"),
        Point("sf", H, 16, type="int16"),
        Point("run", "coils", 0),
    ]
)

NOON = datetime(2026, 7, 1, 12, tzinfo=UTC)

# Name, the text of the command, and the value of the device; of None there is an error.
COMMANDS: list[tuple[str, str, Any]] = [
    ("number", "21.5", 21.5),
    ("state", '"on"', "on"),
    ("state", "0", "off"),
    ("flags", '{"value": {"door": true, "mode": 5}}', {"door": True, "mode": 5}),
    ("clock", '"2026-07-01T12:00:00Z"', NOON),
    ("clock", '{"value": "2026-07-01T14:00:00+02:00", "id": 7}', NOON),
    ("local", '"2026-07-01T12:00:00Z"', NOON),
    ("times", '["2026-07-01T12:00:00Z", "2026-07-01T12:00:00Z"]', [NOON, NOON]),
    ("flag", "true", True),
    ("name", '"ab"', "ab"),
    ("scaled", "1250", 1250),
    ("run", "true", True),
    ("run", "0", False),
    ("state", '"up"', None),
    ("flags", '{"value": {"dor": true}}', None),
    ("clock", '"2026-07-01T12:00:00"', None),
    ("clock", '"noon"', None),
    ("clock", "7", None),
    ("clock", "null", None),
    ("times", '["2026-07-01T12:00:00Z", "x"]', None),
    ("times", '"2026-07-01T12:00:00Z"', None),
]


def test_every_kind_of_value_can_be_written() -> None:
    device = Device.of_map(MAP, {"sf": 1})

    async def go(url: str) -> None:
        async with Fleet([DeviceConfig("d", url, MAP, interval=3600)]) as fleet:
            commands = Commands(fleet)
            for check, (name, text, value) in each(COMMANDS):
                outcome = await commands.answer("d", name, wanted_of(text.encode()))
                with check:
                    assert outcome is not None
                    assert outcome["ok"] is (value is not None)
                    if value is None:
                        assert outcome["error"].startswith(f"{name}: value")
                    else:
                        assert device[name] == value

    with Server(device).background("tcp://127.0.0.1:0") as serving:
        asyncio.run(go(serving.urls[0]))


def test_what_is_reported_can_be_written() -> None:
    line = as_json([Reading(0.0, "d", "clock", NOON, "", "good", "")]).decode()
    told = json.loads(line)["value"]
    device = Device.of_map(MAP)

    async def go(url: str) -> None:
        async with Fleet([DeviceConfig("d", url, MAP, interval=3600)]) as fleet:
            await fleet.write("d", {"clock": told})

    with Server(device).background("tcp://127.0.0.1:0") as serving:
        asyncio.run(go(serving.urls[0]))
    assert device["clock"] == NOON
