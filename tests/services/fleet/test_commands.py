"""Commands: values of every kind, in order for each device, and as many as are promised."""

import asyncio
import json
from datetime import UTC, datetime
from typing import Any

from libmodbus_py import Device, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig, Fleet
from libmodbus_py.services.fleet.commands import Commands, command_of
from libmodbus_py.services.fleet.statistics import FleetStatistics
from tests.services.fleet.fleets import Peer, good, in_simulated_time, meter, polling
from tests.support.cases import each, each_case

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
                outcome = json.loads(await commands.answer("d", name, text.encode()) or b"")
                with check:
                    assert outcome["ok"] is (value is not None)
                    if value is None:
                        assert outcome["error"].startswith(f"{name}: value")
                    else:
                        assert device[name] == value

    with Server(device).background("tcp://127.0.0.1:0") as serving:
        asyncio.run(go(serving.urls[0]))


@each_case(
    "data",
    [
        b'{"value": 1, "value": 2}',
        b'{"value": 1, "id": 1, "id": 2}',
        b'{"value": {"door": 1, "door": 0}}',
        b'[{"a": 1, "a": 1}]',
        b'{"value": 1, "v\\u0061lue": 2}',
    ],
)
def test_a_name_that_occurs_twice_is_refused(data: bytes) -> None:
    problem = command_of(data).problem
    assert problem.endswith(": occurs twice in its JSON")


class Devices:
    """Devices whose writes end when they may; `gone` are those that were removed meanwhile."""

    def __init__(self) -> None:
        self.statistics = FleetStatistics()
        self.may_end: dict[str, asyncio.Event] = {}
        self.begun: list[tuple[str, Any]] = []
        self.gone: set[str] = set()

    def unknown(self, device: str, point: str) -> str:
        return f"there is no device {device!r}" if device in self.gone else ""

    async def write(self, device: str, values: dict[str, Any]) -> None:
        self.begun.append((device, *values.items()))
        await self.may_end.setdefault(device, asyncio.Event()).wait()


@in_simulated_time
async def test_a_command_waits_for_the_previous_one_and_for_no_other_device() -> None:
    devices = Devices()
    commands = Commands(devices)

    async def write(device: str, point: str, value: int) -> Any:
        return await commands.answer(device, point, str(value).encode())

    tasks = [
        asyncio.create_task(write(*entry))
        for entry in (("pump", "level", 1), ("pump", "limit", 2), ("fan", "level", 3))
    ]
    for _ in range(10):
        await asyncio.sleep(0)
    assert devices.begun == [("pump", ("level", 1)), ("fan", ("level", 3))]
    devices.may_end["pump"].set()
    devices.may_end["fan"].set()
    await asyncio.gather(*tasks)
    assert devices.begun[2] == ("pump", ("limit", 2))
    assert json.loads(tasks[1].result())["ok"]


@in_simulated_time
async def test_a_waiting_command_is_refused_if_its_device_was_removed() -> None:
    devices = Devices()
    commands = Commands(devices)
    tasks = [asyncio.create_task(commands.answer("pump", "level", value)) for value in (b"1", b"2")]
    await asyncio.sleep(0)
    devices.gone.add("pump")
    devices.may_end["pump"].set()
    outcomes = await asyncio.gather(*tasks)
    assert [json.loads(outcome or b"").get("error") for outcome in outcomes] == [
        None,
        "there is no device 'pump'",
    ]
    assert len(devices.begun) == 1


@in_simulated_time
async def test_the_repetition_of_a_write_is_not_overtaken_by_the_next_write() -> None:
    """The first attempt gets no answer: the device must hear 20, 20 and then 25."""
    values: list[int] = []

    async def forgetful(request: bytes) -> bytes | None:
        if request[7] == 6:
            values.append(int.from_bytes(request[10:12], "big"))
            if len(values) == 1:
                return None
        return await good(request)

    async with Peer(forgetful) as peer:
        url = f"{peer.url}?timeout=0.5&retries=1&max_in_flight=4"
        async with polling(meter("north", url, interval=60)) as (fleet, _):
            outcomes = await asyncio.gather(
                fleet.commands.answer("north", "setpoint", b"20"),
                fleet.commands.answer("north", "setpoint", b"25"),
            )
            assert [json.loads(outcome or b"")["ok"] for outcome in outcomes] == [True, True]
    assert values == [20, 20, 25]


@in_simulated_time
async def test_commands_beyond_the_limit_are_refused() -> None:
    devices = Devices()
    commands = Commands(devices)

    async def write(device: str) -> str:
        outcome = await commands.answer(device, "level", b"1")
        return str(json.loads(outcome or b"").get("error", "written"))

    waiting = [asyncio.create_task(write(f"pump {at}")) for at in range(100)]
    refused = await next(asyncio.as_completed(waiting))
    assert refused == f"{len(devices.begun)} writes are already under way"
    assert 1 < len(devices.begun) < 100
    for may_end in devices.may_end.values():
        may_end.set()
    ends = await asyncio.gather(*waiting)
    assert ends.count("written") == len(devices.begun)
    assert await write("pump 0") == "written"
    assert devices.statistics.commands == len(devices.begun)
    assert devices.statistics.refused_commands == ends.count(refused)
