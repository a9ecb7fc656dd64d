"""Discovery by Home Assistant, over a real broker, as a subscriber sees it."""

import asyncio
import signal
import subprocess
import sys
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import aiomqtt
import pytest

from libmodbus_py import Device, Fleet, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.outputs.discovery import CLASS_OF, Discovery, Topics
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.topics import Topic
from libmodbus_py.services.fleet.poller import DeviceState
from tests.services.fleet.fleets import meter, real_peer, until
from tests.services.fleet.outputs.brokers import Broker, hearing, publish
from tests.services.fleet.outputs.home_assistant import UNITS, HomeAssistant, check, home_assistant

H: Literal["holding_registers"] = "holding_registers"

EVERY_KIND = RegisterMap(
    [
        Point("voltage", "input_registers", 0, scale=0.1, units="V"),
        Point("energy", "input_registers", 1, type="uint32", units="kWh", never_falls=True),
        Point("flow", "input_registers", 3, units="m3/h"),
        Point("humidity", "input_registers", 4, units="%"),
        Point("counter", "input_registers", 5),
        Point("mode", H, 0, states={0: "off", 1: 'an "auto" {{ mode }}'}),
        Point("setpoint", H, 1, type="int16", scale=0.1, units="C", minimum=10, maximum=30),
        Point("gain", H, 2, type="float32"),
        Point("valve", "coils", 0),
        Point("door", "discrete_inputs", 0),
        Point("alarm", H, 4, bit=3),
        Point("alarms", H, 4, bits={0: "door", "4..7": "level"}, access="read"),
        Point("levels", H, 5, count=3, units="L", access="read"),
        Point("flags", H, 8, type="bits16", access="read"),
        Point("label", H, 9, type="string:8"),
        Point("clock", H, 13, type="unix32"),
        Point("start", "coils", 1, access="write"),
    ]
)


def device_of_every_kind() -> Device:
    return Device(
        Mapping(
            input_registers={0: [2305, 0, 99, 7, 55, 1234]},
            holding_registers={
                0: [1, 215, 0x3FC0, 0, 0x58, 1, 2, 3, 0x8001, 0x4142, 0, 0, 0, 0x6500, 0]
            },
            coils={0: [True, False]},
            discrete_inputs={0: [False]},
        )
    )


@asynccontextmanager
async def discovered(
    broker: Broker, *devices: DeviceConfig, **options: Any
) -> AsyncIterator[tuple[Fleet, HomeAssistant]]:
    """A fleet that Home Assistant discovers."""
    output = Mqtt(broker.url, discovery="homeassistant", **options)
    async with home_assistant(broker) as home, Fleet(devices, outputs=[output]) as fleet:
        yield fleet, home


@pytest.mark.parametrize("topic", ["modbus/{device}/{name}", "plant/{label.site}/{device}"])
async def test_each_kind_of_point_has_an_entity_in_home_assistant(broker: Broker, topic) -> None:
    device = device_of_every_kind()
    async with (
        Server({1: device}).serving("tcp://127.0.0.1:0") as running,
        discovered(
            broker,
            meter("north", running.urls[0], map=EVERY_KIND, interval=60, labels={"site": "Köln"}),
            topic=topic,
            commands=True,
        ) as (fleet, home),
    ):
        await fleet.write("north", {"setpoint": 21.5})  # which makes a poll at once
        await until(lambda: len(home.entities) == 35 and home.is_available("voltage"))
        components = {config["name"]: entry for entry, config in home.entities.values()}
        states = {name: home.state(name) for name in components if name != "start"}
        assert states == {
            "voltage": 230.5,
            "energy": 99,
            "flow": 7,
            "humidity": 55,
            "counter": 1234,
            "mode": 'an "auto" {{ mode }}',
            "setpoint": 21.5,
            "gain": 1.5,
            "valve": True,
            "door": False,
            "alarm": True,
            "alarms door": False,
            "alarms level": 5,
            "levels 0": 1,
            "levels 1": 2,
            "levels 2": 3,
            **{f"flags {at}": at in (0, 15) for at in range(16)},
            "label": "AB",
            "clock": "2023-09-12T06:06:56+00:00",
        }
        assert {name: item for name, item in components.items() if "sensor" not in item} == {
            "mode": "select",
            "setpoint": "number",
            "gain": "number",
            "valve": "switch",
            "alarm": "switch",
            "label": "text",
            "start": "switch",
        }
        kinds = {name: home.entity(name)[1].get("device_class") for name in components}
        assert {name: kind for name, kind in kinds.items() if kind} == {
            "voltage": "voltage",
            "energy": "energy",
            "flow": "volume_flow_rate",
            "setpoint": "temperature",
            "clock": "timestamp",
            **{f"levels {at}": "volume" for at in range(3)},
        }


async def test_a_value_that_a_user_sets_is_written_and_shown_at_once(broker: Broker) -> None:
    device = device_of_every_kind()
    async with (
        Server({1: device}).serving("tcp://127.0.0.1:0") as running,
        discovered(
            broker,
            meter("north", running.urls[0], map=EVERY_KIND, interval=0.5, on_change=True),
            commands=True,
        ) as (fleet, home),
        hearing(broker, "modbus/+/+/set/result") as messages,
    ):
        await until(lambda: len(home.entities) == 35 and home.is_available("voltage"))
        values = {"setpoint": 12.3, "mode": "off", "valve": False, "gain": -2.5}
        values |= {"label": 'a"', "alarm": False}
        fleet.replace([replace(device.config, interval=600) for device in fleet.devices.values()])
        await until(lambda: fleet.devices["north"].state is DeviceState.NEW)
        for name, value in values.items():
            await home.set(name, value)
            await until(lambda: home.state(name) == value)  # noqa: B023
        await home.set("start", True)
        await until(lambda: device.mapping.coils[1] and len(messages) == 7)
        assert [payload["ok"] for _, payload, _ in messages] == [True] * 7
        # Home Assistant knows the range, others may not.
        await home.set("setpoint", 31)
        await home.set("mode", "of")
        await until(lambda: len(messages) == 9)
        assert [payload["ok"] for _, payload, _ in messages[7:]] == [False] * 2
        assert (home.state("setpoint"), home.state("mode")) == (12.3, "off")


async def test_without_commands_nothing_can_be_set(broker: Broker) -> None:
    async with real_peer() as peer:
        north = meter("north", peer.url, map=EVERY_KIND, items=("setpoint", "mode"))
        async with discovered(broker, north) as (_, home):
            await until(lambda: len(home.entities) == 2)
            assert home.names == {"sensor: north: setpoint", "sensor: north: mode"}


async def test_entities_are_available_while_the_poller_and_the_device_answer(broker: Broker):
    async with home_assistant(broker) as home, real_peer() as peer:
        devices = [meter("a", peer.url), meter("down", "tcp://127.0.0.1:1")]
        async with Fleet(devices, outputs=[Mqtt(broker.url, discovery="homeassistant")]) as fleet:
            await until(lambda: len(home.entities) == 6 and home.is_available("power", "a"))
            assert not home.is_available("power", "down")
            fleet.replace([meter("a", "tcp://127.0.0.1:1"), devices[1]])
            await until(lambda: not home.is_available("power", "a"))
            fleet.replace(devices)
            await until(lambda: home.is_available("power", "a"))
        await until(lambda: not home.is_available("power", "a"))
        assert len(home.entities) == 6  # the entities are only unavailable


def points(count: int) -> RegisterMap:
    return RegisterMap(Point(f"point {at}", H, at, units="V") for at in range(count))


async def test_two_hundred_entities_are_added_and_deleted(broker: Broker) -> None:
    async with real_peer() as peer:
        devices = [meter(f"meter {at}", peer.url, map=points(20)) for at in range(10)]
        async with discovered(broker, *devices, topic="plant/{device}") as (fleet, home):
            await until(lambda: len(home.entities) == 200)
            await until(lambda: all(home.is_available("point 7", item.name) for item in devices))
            assert {home.state("point 19", device.name) for device in devices} == {7.0}
            fleet.replace(devices[:1])
            await until(lambda: len(home.entities) == 20)
            fleet.replace([meter("meter 0", peer.url, map=points(3))])
            await until(lambda: len(home.entities) == 3)
            fleet.replace([])
            await until(lambda: not home.entities)
            assert len(home.added) == 203
        async with hearing(broker, "homeassistant/#", "modbus/status") as messages:
            await until(lambda: messages)
        assert [topic for topic, *_ in messages] == [
            "modbus/status"
        ]  # the broker retains nothing else


NAMES = [
    "Köln 1",
    "a/b",
    "+",
    "#",
    "50 %",
    'a "quoted" name',
    "a\\b",
    "{{ x }}",
    "😀",
    "a b",
    "a_b",
]


@pytest.mark.parametrize("topic", ["modbus/{device}/{name}", "plant/{device}"])
async def test_names_with_any_characters_become_names_of_entities(broker: Broker, topic: str):
    map_ = RegisterMap(Point(name, H, at) for at, name in enumerate(NAMES))
    async with real_peer() as peer:
        devices = [meter(name, peer.url, map=map_) for name in NAMES]
        async with discovered(broker, *devices, topic=topic, commands=True) as (fleet, home):
            await until(lambda: len(home.entities) == len(NAMES) ** 2)
            assert home.names == {f"number: {a}: {b}" for a in NAMES for b in NAMES}
            await until(lambda: all(home.is_available(NAMES[0], name) for name in NAMES))
            await until(lambda: all(home.state(a, b) == 7.0 for a in NAMES for b in NAMES))
            for name in NAMES:
                await home.set(name, 7, name)
            await until(lambda: fleet.statistics.commands == len(NAMES))
            fleet.replace([])
            await until(lambda: not home.entities)


async def test_devices_that_are_rarely_polled_appear_at_the_start_and_are_removed(broker: Broker):
    async with real_peer() as peer:
        devices = [meter(name, peer.url, interval=86_400) for name in ("a", "b")]
        async with discovered(broker, *devices) as (fleet, home):
            await until(lambda: len(home.entities) == 6)
            fleet.replace(devices[:1])
            await until(lambda: len(home.entities) == 3)
            assert fleet.statistics.polls == 0


async def test_a_device_that_is_renamed_in_a_reload_has_other_entities(broker: Broker) -> None:
    async with real_peer() as peer:
        north, south = meter("north", peer.url), meter("south", peer.url, unit=2)
        async with discovered(broker, north, south) as (fleet, home):
            await until(lambda: len(home.entities) == 6)
            fleet.replace([replace(north, name="nord"), replace(south)])
            await until(lambda: len(home.removed) == 3 and len(home.entities) == 6)
            assert {config["device"]["name"] for _, config in home.entities.values()} == {
                "nord",
                "south",
            }
            await until(lambda: fleet.statistics.polls > 10)
            assert len(home.added) == 9  # what has not changed is not published again


async def test_a_changed_label_in_the_topic_keeps_the_entities(broker: Broker) -> None:
    async with real_peer() as peer:
        north = meter("north", peer.url, labels={"site": "x"})
        options = {"topic": "plant/{label.site}/{device}/{name}"}
        async with discovered(broker, north, **options) as (fleet, home):
            await until(lambda: len(home.entities) == 3)
            fleet.replace([replace(north, labels={"site": "y"})])
            await until(lambda: len(home.added) == 6)
            assert home.entity("power")[1]["state_topic"] == "plant/y/north/power"
            assert (len(home.entities), home.removed) == (3, [])
            await until(lambda: home.state("power") == 7)


FOREIGN = "homeassistant/sensor/zigbee/other/config"


async def test_configurations_of_an_earlier_run_are_deleted_at_the_next_start(broker: Broker):
    other = '{"name": "x", "state_topic": "x"}'
    await publish(broker, FOREIGN, other.encode(), retain=True)
    async with real_peer() as peer:
        north = meter("north", peer.url)
        others = [meter(f"other {at}", peer.url, map=points(40)) for at in range(5)]
        async with discovered_now(
            broker, [north, *others], topic="other/{device}/{name}"
        ) as topics:
            await until(lambda: len(topics) == 204)
        smaller = replace(north, items=("voltage", "setpoint"))
        # Another topic, one device and one point less, and one that can be set.
        async with discovered_now(broker, [smaller], commands=True) as topics:
            await until(lambda: len([*topics]) == 3)
            assert topics.pop(FOREIGN) == other
            components = sorted(topic.split("/")[1] for topic in topics)
            assert components == ["number", "sensor"]


@asynccontextmanager
async def discovered_now(
    broker: Broker, devices: list[DeviceConfig], **options: Any
) -> AsyncIterator[dict[str, Any]]:
    """Yield the configurations that a broker retains, as they change."""
    retained: dict[str, Any] = {}
    async with aiomqtt.Client("127.0.0.1", broker.port) as client:
        await client.subscribe("homeassistant/#", 1)

        async def listen() -> None:
            async for message in client.messages:
                assert isinstance(message.payload, bytes)
                if message.payload:
                    retained[str(message.topic)] = message.payload.decode()
                else:
                    retained.pop(str(message.topic), None)

        listening = asyncio.create_task(listen())
        output = Mqtt(broker.url, discovery="homeassistant", **options)
        async with Fleet(devices, outputs=[output]) as fleet:
            count = sum(len(device.names) for device in devices)
            await until(lambda: fleet.statistics.outputs[output.name].written >= count)
            yield retained
        listening.cancel()
        await asyncio.gather(listening, return_exceptions=True)


async def test_pollers_with_one_prefix_keep_the_entities_of_each_other(broker: Broker) -> None:
    """Which of them comes first, and whichever ends."""
    async with real_peer() as peer:
        first, second = ([meter(name, peer.url, unit=2)] for name in ("first", "second"))
        async with home_assistant(broker) as home, discovered_now(broker, first):
            await until(lambda: len(home.entities) == 3)
            for end in ("first end", "second end"):
                async with discovered_now(broker, second):
                    await until(lambda: len(home.entities) == 6)
                await publish(broker, end, b"behind all that was published")
                await until(lambda: end in home.payloads)  # noqa: B023
            assert home.removed == []


async def test_a_killed_poller_leaves_no_entities_to_its_successor_with_another_file(
    broker: Broker, tmp_path: Path
) -> None:
    (tmp_path / "meter.csv").write_text("name,table,address\nx,holding_registers,0\n")

    def start(device: str) -> subprocess.Popen[bytes]:
        (tmp_path / "fleet.toml").write_text(
            f'[output.mqtt]\nurl = "{broker.url}"\ndiscovery = "homeassistant"\n'
            f'[[device]]\nname = "{device}"\nurl = "tcp://127.0.0.1:1"\nmap = "meter.csv"\n'
            "interval = 0.1\n"
        )
        program = [sys.executable, "-m", "libmodbus_py", "poll", str(tmp_path / "fleet.toml")]
        return subprocess.Popen(program)

    async with home_assistant(broker) as home:
        for name, number in (("a", signal.SIGKILL), ("b", signal.SIGTERM)):
            with start(name) as poller:
                await until(lambda: home.names == {f"sensor: {name}: x"})  # noqa: B023
                poller.send_signal(number)


async def test_a_broker_that_lost_its_retained_messages_gets_them_again(broker: Broker) -> None:
    async with real_peer() as peer:
        output = Mqtt(broker.url, discovery="homeassistant")
        fleet = Fleet([meter("a", peer.url), meter("b", peer.url, unit=2)], outputs=[output])
        async with fleet:
            statistics = fleet.statistics.outputs[output.name]
            await until(lambda: statistics.written >= 6)
            for _ in range(2):
                await broker.restart(statistics)
                async with home_assistant(broker) as home:
                    await until(lambda: len(home.entities) == 6)
                    await until(lambda: home.is_available("power", "a"))
            broker.kill()
            await until(lambda: statistics.trouble)
            fleet.replace([meter("a", peer.url)])  # while the broker is away
            broker.start()
            async with home_assistant(broker) as home:
                await until(lambda: len(home.entities) == 3 and home.is_available("power"))


def discovery() -> Discovery:
    status = Topic("device_status", "modbus/status/{device}/state", ("device",))
    point = Topic("topic", "modbus/{device}/{name}", ("device", "name"))
    return Discovery(Topics("modbus/status", status, point, point, True, False))


def messages_of(discovery_: Discovery, device: DeviceConfig, quality: Any) -> list[bytes]:
    readings = [Reading(0.0, device.name, name, 1, "", quality) for name in device.names]
    changed = discovery_.changed(readings)
    payloads = [message.payload for message in discovery_.messages(changed)]
    discovery_.keep_devices(changed, readings, set())
    return payloads


def test_a_device_that_another_worker_polls_keeps_its_entities() -> None:
    discovery_, device = discovery(), meter("a", "tcp://192.0.2.1")
    discovery_.describe({"a": device})
    assert len(messages_of(discovery_, device, "good")) == 3
    assert messages_of(discovery_, device, "offline") == []  # the lease was lost
    discovery_.describe({})  # it is passed on
    assert messages_of(discovery_, device, "good") == []  # readings that waited
    assert list(discovery_.last_messages()) == []
    discovery_.describe({"a": replace(device)})
    assert len(messages_of(discovery_, device, "good")) == 3  # the other worker may have done so
    assert messages_of(discovery_, device, "good") == []
    discovery_.describe({"a": replace(device)})  # the file was read again
    assert messages_of(discovery_, device, "good") == []
    discovery_.describe({})
    assert messages_of(discovery_, device, "offline") == [b""] * 3
    assert messages_of(discovery_, device, "offline") == []
    assert discovery_.published == {}


def test_a_device_removed_while_it_is_published_is_deleted() -> None:
    discovery_, device = discovery(), meter("a", "tcp://192.0.2.1")
    discovery_.describe({"a": device})
    readings = [Reading(0.0, "a", "power", 1, "", "good")]
    changed = discovery_.changed(readings)
    discovery_.describe({})
    discovery_.keep_devices(changed, readings, set())
    assert messages_of(discovery_, device, "offline") == [b""] * 3


def test_configurations_that_another_poller_may_have_published_are_not_deleted() -> None:
    entities = discovery()
    entities.describe({"a": meter("a", "tcp://192.0.2.1")})
    entities.add_topic("homeassistant/sensor/x/y/config")
    assert entities.leftovers(is_alone=True) == {"homeassistant/sensor/x/y/config"}
    assert entities.leftovers(is_alone=False) == set()
    assert entities.leftovers(is_alone=True) == set()  # the connection was lost, and is there again


def test_numbers_have_bounds_and_steps_that_are_allowed() -> None:
    def entity(**options: Any) -> tuple[str, dict[str, Any]]:
        map_ = RegisterMap([Point("x", H, 0, **options), Point("f", H, 8)])
        discovery_ = Discovery(discovery()._topics._replace(takes_commands=True))
        discovery_.describe({"a": meter("a", "tcp://192.0.2.1", map=map_)})
        topic, config = next(discovery_._entities(discovery_.devices["a"]))
        return check(topic, config), {key: config.get(key) for key in ("min", "max", "step")}

    for options, component, bounds in (
        ({}, "number", (0, 65535, 1)),
        ({"scale": 0.0001}, "number", (0, 6.5535, 0.001)),
        ({"type": "float32", "minimum": -5}, "number", (-5, 3.4028234663852886e38, 0.001)),
        ({"scale_from": "f"}, "number", (-1e9, 1e9, 1)),
        ({"bit": "4..7"}, "number", (0, 15, 1)),
        ({"minimum": 1, "maximum": 1}, "sensor", (None, None, None)),
    ):
        assert entity(**options) == (
            component,
            dict(zip(("min", "max", "step"), bounds, strict=True)),
        )


def test_units_and_device_classes_are_valid_pairs_in_home_assistant() -> None:
    assert all(unit in UNITS[name].split() for unit, name in CLASS_OF.items())
