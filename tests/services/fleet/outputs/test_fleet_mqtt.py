"""MQTT with a real broker: TLS, the last will, commands, and a message for each poll."""

import asyncio
import logging
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import aiomqtt
import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs import mqtt_connection
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.fleet.outputs.writer import OutputWriter
from libmodbus_py.tools.certificates import Identity
from tests.services.fleet.fleets import meter, real_peer, until
from tests.services.fleet.outputs.brokers import (
    Broker,
    commanded,
    hearing,
    payloads,
    plain,
    publish,
)
from tests.support import certificates
from tests.support.certificates import Pki
from tests.support.golden import Refused
from tests.support.outputs import output_writer


def secure(broker: Broker, pki: Pki, identity: Identity) -> str:
    """Let the broker listen for TLS, too, and return that URL."""
    files = pki.files(identity)
    port = broker.new_port()
    broker.change(
        f"listener {port} 127.0.0.1",
        f"certfile {files.cert}",
        f"keyfile {files.key}",
        "allow_anonymous true",
    )
    return f"mqtts://127.0.0.1:{port}"


async def test_readings_arrive_over_tls(broker: Broker, tmp_path: Path) -> None:
    pki = Pki(tmp_path)
    url = secure(broker, pki, certificates.server())
    async with real_peer() as peer:
        device = meter("a", peer.url, interval=60)
        output = Mqtt(url, ca=str(pki.ca))
        await Fleet([device], outputs=[output]).run(once=True)
    async with hearing(broker, "#") as messages:
        await until(lambda: len(messages) >= 4)


@pytest.mark.parametrize("wrong", ["another authority", "another host"])
async def test_an_untrusted_broker_gets_no_reading(broker: Broker, tmp_path, wrong) -> None:
    pki = Pki(tmp_path)
    is_foreign = wrong == "another authority"
    identity = certificates.server(**({} if is_foreign else {"hosts": ("other.example",)}))
    trusted = pki.authority(certificates.foreign_authority()) if is_foreign else pki.ca
    url = secure(broker, pki, identity)
    async with real_peer() as peer, hearing(broker, "#") as messages:
        output = Mqtt(url, ca=str(trusted), password="secret", user="user")
        async with Fleet([meter("a", peer.url, interval=0.05)], outputs=[output]) as fleet:
            statistics = fleet.statistics.outputs[output.name]
            await until(lambda: statistics.trouble)
            assert "certificate" in statistics.trouble.lower()
        assert messages == []


async def test_an_invalid_file_of_authorities_is_named(tmp_path: Path) -> None:
    (tmp_path / "ca.pem").write_text("nothing")
    output = Mqtt("mqtts://127.0.0.1:1", ca=str(tmp_path / "ca.pem"))
    with pytest.raises(OSError, match="contains no certificate"):
        await output.open_output()


async def test_the_last_will_reports_a_killed_poller(broker: Broker, tmp_path: Path) -> None:
    """A poller is killed: the broker says so, not the poller."""
    (tmp_path / "meter.csv").write_text("name,table,address\nx,holding_registers,0\n")
    (tmp_path / "fleet.toml").write_text(
        f'[output.mqtt]\nurl = "{broker.url}"\nstatus = "poller"\n'
        '[[device]]\nname = "a"\nurl = "tcp://127.0.0.1:1"\nmap = "meter.csv"\n'
    )
    async with hearing(broker, "poller") as messages:
        program = [sys.executable, "-m", "libmodbus_py", "poll", str(tmp_path / "fleet.toml")]
        with subprocess.Popen(program) as poller:
            await until(lambda: payloads(messages, "poller") == ["online"])
            poller.kill()
        await until(lambda: payloads(messages, "poller")[1:] == ["offline"])


@pytest.mark.parametrize("options", [{"user": "user", "password": "wrong"}, {}])
async def test_wrong_credentials_are_reported_in_one_line(broker: Broker, options, caplog) -> None:
    reason = "Not authorized"
    broker.settings[1] = f"password_file {broker._folder / 'passwords'}"
    broker.change()
    async with real_peer() as peer:
        output = Mqtt(broker.url, **options)
        async with Fleet([meter("a", peer.url)], outputs=[output]) as fleet:
            statistics = fleet.statistics.outputs[output.name]
            await until(lambda: statistics.failures > 1)
            assert reason in statistics.trouble
            assert fleet.statistics.failures == 0
        right = Mqtt(broker.url, user="user", password="secret")
        fleet = Fleet([meter("a", peer.url, interval=60)], outputs=[right])
        await fleet.run(once=True)
        assert fleet.statistics.outputs[right.name].written == 3
    warned = [record for record in caplog.records if record.levelno >= logging.WARNING]
    assert len([record for record in warned if reason in record.getMessage()]) == 1
    assert "wrong" not in caplog.text
    assert "secret" not in caplog.text


async def test_a_silent_connection_does_not_delay_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mqtt_connection, "TIMEOUT_S", 0.2)
    silent = socket.create_server(("127.0.0.1", 0))
    port = silent.getsockname()[1]
    async with real_peer() as peer:
        output = Mqtt(f"mqtt://127.0.0.1:{port}")
        async with Fleet([meter("a", peer.url, interval=0.05)], outputs=[output]) as fleet:
            await until(lambda: fleet.statistics.outputs[output.name].trouble)
            assert "timed out" in fleet.statistics.outputs[output.name].trouble
            await until(lambda: fleet.statistics.polls > 5)
    silent.close()


async def test_writes_are_answered_with_their_outcome(broker: Broker) -> None:
    cases: list[tuple[str, bytes, str]] = [
        ("a/setpoint", b"21", ""),
        ("a/setpoint", b'{"value": 22, "id": "x7"}', ""),
        ("a/setpoint", b"31", "setpoint: value must be in 10..30, not 31"),
        ("a/setpoint", b'"22"', "setpoint: value must be"),
        ("a/voltage", b"1", "access is read"),
        ("a/nothing", b"1", "no point 'nothing'"),
        ("nobody/setpoint", b"21", "there is no device 'nobody'"),
        ("down/setpoint", b"21", "cannot connect"),
        ("a/setpoint", b"hot", "it must be a value in JSON, not b'hot'"),
        ("a/setpoint", b"", "it must be a value in JSON"),
        ("a/setpoint", b'{"val": 3}', "an object must have a value"),
        ("a/setpoint", b'{"value": 3, "id": [1]}', "id must be text or a number"),
        ("a/setpoint", b"[" * 4000, "it must be a value in JSON"),
        ("a/setpoint", b"1" * 5000, "at most 4096 bytes"),
    ]
    async with commanded(broker, commands=True) as (fleet, messages, device):
        for at, (topic, data, error) in enumerate(cases):
            await publish(broker, f"modbus/{topic}/set", data)
            await until(lambda at=at: len(messages) > at)
            result_topic, outcome, _ = messages[at]
            assert result_topic == f"modbus/{topic}/set/result"
            assert outcome["ok"] is not bool(error)
            assert error in outcome.get("error", "")
            assert outcome.get("id") == ("x7" if b"x7" in data else None)
        assert device.mapping.holding_registers[2] == 22
        assert fleet.statistics.commands == 2
        assert fleet.statistics.refused_commands == len(cases) - 2
        # A retained command is an old one.
        await publish(broker, "modbus/a/setpoint/set", b"15", retain=True)
        await until(lambda: device.mapping.holding_registers[2] == 15)
    async with commanded(broker, commands=True) as (fleet, messages, device):
        await publish(broker, "modbus/a/setpoint/set", b"16")
        await until(lambda: device.mapping.holding_registers[2] == 16 and messages)
        assert fleet.statistics.commands == 1


async def test_commands_do_nothing_unless_they_are_enabled(broker: Broker) -> None:
    async with commanded(broker) as (fleet, messages, device):
        await publish(broker, "modbus/a/setpoint/set", b"21")
        before = fleet.statistics.polls
        await until(lambda: fleet.statistics.polls > before + 5)
        assert (messages, device.mapping.holding_registers[2]) == ([], 20)


async def test_a_flood_of_commands_is_bounded(broker: Broker) -> None:
    async with commanded(broker, commands=True) as (fleet, messages, _):
        async with aiomqtt.Client("127.0.0.1", broker.port) as client:
            for at in range(500):
                await client.publish("modbus/down/setpoint/set", b"21", 0)
                if at % 50 == 0:
                    assert len(asyncio.all_tasks()) < 300
        polls = fleet.statistics.polls
        await until(lambda: fleet.statistics.polls > polls + 5)
        await until(lambda: len(messages) > 20)
        assert fleet.statistics.commands == 0
        assert fleet.statistics.up == 1


TOPIC = "plant/{device}"


def poll(device: str, at: float, **values: Any) -> list[Reading]:
    return [
        Reading(100.0 + at, device, name, value, "V", "good", "", round(at) + 1)
        for name, value in values.items()
    ]


async def write_all(writer: OutputWriter, readings: list[Reading]) -> None:
    count = writer.statistics.written + len(readings)
    writer.buffer.put_readings(readings)
    await until(lambda: writer.statistics.written == count)


async def test_a_retained_message_has_the_last_values_of_all_points(broker: Broker) -> None:
    """The broker retains one message of a topic; with changes only, a poll has few values."""
    async with output_writer(Mqtt(broker.url, topic=TOPIC)) as writer:
        await write_all(writer, poll("a", 0, x=1, y=2))
        await write_all(writer, [*poll("a", 1, y=3), *poll("a", 2, z=4)])
        offline = Reading(103.0, "a", "x", None, "V", "offline")
        async with hearing(broker, "plant/+") as messages:
            await until(lambda: messages)
            assert plain(messages[-1][1]) == {"x": 1, "y": 3, "z": 4}
            await write_all(writer, [offline])
            await until(lambda: len(messages) == 2)
            assert plain(messages[-1][1]) == {"x": None, "y": 3, "z": 4}
            await write_all(writer, poll("a", 4, y=5))
            await until(lambda: len(messages) == 3)
            assert plain(messages[-1][1]) == {"y": 5, "z": 4}


async def test_polls_above_the_largest_message_are_split(broker: Broker) -> None:
    broker.change("message_size_limit 2000")
    output = Mqtt(broker.url, topic=TOPIC, retain=False, max_message=2000)
    async with output_writer(output) as writer:
        async with hearing(broker, "plant/+") as notes:
            await write_all(writer, poll("a", 0, **{f"point_{at}": at for at in range(100)}))
            await until(lambda: notes and len(notes) == notes[0][1]["parts"])
        messages = payloads(notes, "plant/a")
        assert [message["part"] for message in messages] == list(range(1, len(messages) + 1))
        assert sum(len(message["values"]) for message in messages) == 100


def test_an_invalid_option_is_named(refused: Refused) -> None:
    refused("refused_mqtt.txt", lambda options: Mqtt(**{"url": "mqtt://192.0.2.1", **options}))
