"""
What people meet of the engine: errors in one line, changes, results over MQTT, commands, status.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import subprocess
import sys
import threading
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest

from fuzz.asked_devices import UNITS, Workers, asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers, free_ports
from libmodbus_py.cli.main import main
from tests.support.pace import LATE
from tests.workers.doubled import none_doubled

nats = pytest.importorskip("nats")

MQTT = """
server_name: test
jetstream {{}}
mqtt {{ listen: "127.0.0.1:{port}" }}
"""


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "libmodbus_py", *arguments],
        capture_output=True,
        text=True,
        timeout=40,
        env={**os.environ, **environment},
    )


def one_line(done: subprocess.CompletedProcess[str], code: int) -> str:
    assert done.returncode == code, done.stderr
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1, done.stderr
    return done.stderr


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.count("\n") == 1
    return told.err


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return fleet_file(tmp_path, ["tcp://127.0.0.1:9"], interval=1, engine="lease = 1")


# --- errors ----------------------------------------------------------------------------------


class OldServer:
    """Says that it is a nats-server of a version, and no more."""

    def __init__(self, version: str) -> None:
        self._info = {"version": version, "max_payload": 1048576, "server_id": "x", "proto": 1}

    def __enter__(self) -> str:
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()
        return f"nats://127.0.0.1:{self._listening.getsockname()[1]}"

    def __exit__(self, *_: object) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._thread.join()

    def _serve(self) -> None:
        try:
            while True:
                connection, _ = self._listening.accept()
                with connection:
                    connection.sendall(b"INFO " + json.dumps(self._info).encode() + b"\r\n")
                    while data := connection.recv(4096):
                        if b"PING" in data:
                            connection.sendall(b"PONG\r\n")
        except OSError:
            pass


def test_what_is_wrong_with_an_engine_is_told_in_one_line(file, tmp_path):
    def told(url: str, **environment: str) -> str:
        line = one_line(run("poll", str(file), "--engine", url, "--push", **environment), 1)
        assert "secret" not in line
        return line

    nobody = f"nats://127.0.0.1:{free_ports(1)[0]}"
    assert "Connection refused" in told(nobody)
    with OldServer("2.8.4") as url:
        assert "nats-server 2.8.4 is too old; 2.9 or newer is needed" in told(url)
    locked = 'authorization { user: u, password: "right" }\njetstream {}'
    with NatsServers(config=lambda _: locked) as server:
        wrong = server.urls.replace("nats://", "nats://u:secret@")
        assert "it refuses these credentials" in told(wrong)
        assert "it refuses these credentials" in told(
            server.urls, NATS_USER="u", NATS_PASSWORD="secret"
        )
        assert "NATS_CA" in told(server.urls, NATS_CA=str(tmp_path / "gone.pem"))
        assert "speaks no TLS" in told(
            server.urls.replace("nats:", "tls:"), NATS_USER="u", NATS_PASSWORD="right"
        )


def test_an_engine_without_jetstream_or_with_another_bucket_is_refused(file):
    with NatsServers(jetstream=False) as server:
        done = run("poll", str(file), "--engine", server.urls)
        assert "JetStream is off" in one_line(done, 1)
    with NatsServers() as server:
        status = ("fleet", "status", "--engine", server.urls)
        assert "there is no fleet yet; put it there with --push" in one_line(run(*status), 1)
        asyncio.run(_bucket(server.urls, history=5))
        assert "bucket modbus-fleet has other settings than ours: history 5, not 1" in one_line(
            run("poll", str(file), "--engine", server.urls), 1
        )
        asyncio.run(_bucket(server.urls, history=1))
        asyncio.run(_write(server.urls, "settings", b'{"format": 7}'))
        assert "format 7; this version knows 1" in one_line(run(*status), 1)


async def _bucket(url: str, history: int) -> None:
    client = await nats.connect(url)
    js = client.jetstream()
    with contextlib.suppress(Exception):
        await js.delete_key_value("modbus-fleet")
    await js.create_key_value(bucket="modbus-fleet", history=history)
    await client.close()


async def _write(url: str, key: str, value: bytes) -> None:
    client = await nats.connect(url)
    await (await client.jetstream().key_value("modbus-fleet")).put(key, value)
    await client.close()


WRONG = [
    ("lease = 0.1", "fleet.toml, line 4: engine.lease must be in 0.5..60.0 s, not 0.1"),
    ('lease = "long"', "line 4: engine.lease must be a number of seconds, not str"),
    ("leese = 1", "line 4: engine.leese: no such key; allowed are lease, on_engine_loss"),
    (
        'on_engine_loss = "hope"',
        "line 4: engine.on_engine_loss must be stop or continue, not 'hope'",
    ),
    ("commands = 1", "line 4: engine.commands must be true or false, not 1"),
    ("max_bytes = 1", "line 4: engine.max_bytes must be in 65536.."),
    ("lease = 0.5", "a timeout of 0.2 s wants engine.lease of 0.667 s or more, not 0.5"),
]


@pytest.mark.parametrize(("engine", "told"), WRONG)
def test_what_is_wrong_in_the_file_is_told_before_anything_is_sent(tmp_path, capsys, engine, told):
    file = fleet_file(tmp_path, ["tcp://127.0.0.1:9"], interval=1, engine=engine)
    assert told in refused(capsys, "poll", str(file), "--engine", "nats://127.0.0.1:9")


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--engine", "http://x"], "'http://x' must be nats://HOST[:PORT] or tls://HOST[:PORT]"),
        (["--engine", "nats://u:secret@h:0"], "'nats://h:0': the port must be in 1..65535"),
        (["--engine", ","], "engine: 1..32 URLs"),
        (["--push"], "--push needs --engine"),
        (["--engine", "nats://h", "--once"], "--once is for one machine"),
        (["--engine", "nats://h", "--zone", "a.b"], "zone 'a.b' must be 1..60 letters"),
    ],
)
def test_wrong_usage_is_told(file, capsys, options, told):
    line = refused(capsys, "poll", str(file), *options)
    assert told in line
    assert "secret" not in line


# --- what it does ------------------------------------------------------------------------------


async def _requested(url: str, subject: str, value: bytes) -> dict[str, Any]:
    client = await nats.connect(url)
    try:
        return json.loads((await client.request(subject, value, timeout=10)).data)
    finally:
        await client.close()


def mosquitto(port: int, topic: str) -> subprocess.Popen[str]:
    command = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(port), "-t", topic, "-C", "1"]
    return subprocess.Popen([*command, "-W", "20"], stdout=subprocess.PIPE, text=True)


@pytest.mark.alone
@pytest.mark.timeout(300)
def test_results_commands_changes_and_status(tmp_path):
    mqtt = free_ports(1)[0]
    engine = "lease = 1\ncommands = true"
    with (
        NatsServers(config=lambda _: MQTT.format(port=mqtt)) as server,
        asked_devices(2) as (urls, asked),
    ):
        file = fleet_file(tmp_path, urls[:1], interval=0.2, engine=engine)
        with Workers(file, tmp_path) as workers:
            workers.start("a", server.urls)
            until(lambda: asked.polls > 0, 30)

            # A reading, seen by a client of MQTT.
            hears = mosquitto(mqtt, "modbus/readings/d0-3")
            reading = json.loads(hears.communicate(timeout=30)[0])
            assert reading["device"] == "d0-3"
            assert reading["values"]["level"]["value"] == 0
            assert reading["values"]["level"]["quality"] == "good"

            # Commands.
            subject = "modbus.write.d0-3.setpoint"
            assert asyncio.run(_requested(server.urls, subject, b"21"))["ok"] is True
            refused = asyncio.run(_requested(server.urls, subject, b"99"))
            assert refused["ok"] is False
            assert "10..30" in refused["error"]
            nobody = asyncio.run(_requested(server.urls, "modbus.write.no%2Eone.setpoint", b"1"))
            assert nobody["error"] == "there is no device 'no.one'"
            outcome = mosquitto(mqtt, "modbus/written/d0-4/setpoint")
            time.sleep(0.5)
            publish = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(mqtt)]
            subprocess.run([*publish, "-t", "modbus/write/d0-4/setpoint", "-m", "12"], check=True)
            assert json.loads(outcome.communicate(timeout=30)[0])["ok"] is True

            # A change reaches the worker, and touches nothing else.
            before = dict(asked.peers)
            fleet_file(tmp_path, urls, interval=0.2, engine=engine)
            assert (
                "1 new, 0 changed, 0 gone"
                in run("poll", str(file), "--engine", server.urls, "--push").stdout
            )
            # A second is promised; seeing it takes an interval, and a connection.
            until(lambda: len(asked.peers) == 2 * UNITS, 1.5 + LATE)
            assert before.items() <= asked.peers.items()

            # What cannot be read is told, and harms nobody.
            for key in ("connection._.abc", "slot._.900", "worker.x.y"):
                asyncio.run(_write(server.urls, key, b"[" * 5000))
            status = json.loads(run("fleet", "status", "--engine", server.urls, "--json").stdout)
            assert len(status["unreadable"]) == 3
            assert [each["name"] for each in status["workers"]] == ["a"]
            assert status["totals"]["devices"] == 2 * UNITS

            # A zone that nobody serves.
            fleet_file(tmp_path, urls, interval=0.2, engine=engine, zone="north")
            run("poll", str(file), "--engine", server.urls, "--push")
            done = run("fleet", "status", "--engine", server.urls)
            assert done.returncode == 1
            assert "nobody serves zone 'north'" in done.stderr
            assert "nobody serves it" in done.stdout
            lost = asyncio.run(_requested(server.urls, subject, b"21"))
            assert lost["error"] == "nobody polls 'd0-3' now"
            workers.start("b", server.urls, "--zone", "north")
            now = time.monotonic()
            until(lambda: asked.since(now) == 2 * UNITS, 15)
            none_doubled(asked)


@pytest.mark.alone
def test_it_goes_on_without_the_engine_when_told_so_and_keeps_what_it_read(tmp_path):
    engine = 'lease = 1\non_engine_loss = "continue"'
    with NatsServers() as server, asked_devices(1) as (urls, asked):
        file = fleet_file(tmp_path, urls, interval=0.2, engine=engine)
        with Workers(file, tmp_path) as workers:
            workers.start("a", server.urls)
            until(lambda: asked.polls > 0, 30)
            server.kill()
            gone = time.time()
            time.sleep(2.5)
            now = time.monotonic()
            until(lambda: asked.since(now) == UNITS, 5)
            back = time.time()
            server.start(0)

            def kept() -> bool:
                times = asyncio.run(_times(server.urls, "modbus.readings.d0-1"))
                return sum(gone + 1 < each < back for each in times) >= 5

            until(kept, 20)
            none_doubled(asked)


async def _times(url: str, subject: str) -> list[float]:
    """When the device was read whose readings are in the stream."""
    client = await nats.connect(url)
    found: list[float] = []
    try:
        subscription = await client.jetstream().subscribe(subject, ordered_consumer=True)
        pending = 1
        while pending:
            message = await subscription.next_msg(timeout=5)
            pending = message.metadata.num_pending
            told = json.loads(message.data)["values"]["level"]["time"]
            found.append(datetime.fromisoformat(told).timestamp())
        return found
    finally:
        await client.close()
