"""What people meet of the engine: errors, changes, results over MQTT, commands, status."""

import contextlib
import json
import os
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from fuzz.asked_devices import UNITS, Workers, asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers, free_ports
from tests.support.commands import run

pytest.importorskip("nats")

MQTT = """
server_name: test
jetstream {{}}
mqtt {{ listen: "127.0.0.1:{port}" }}
"""


def failed(*arguments: object, code: int = 1) -> str:
    """Run a command that fails; return the line that it prints."""
    result = run(*arguments)
    assert (result.code, result.out, result.err.count("\n")) == (code, "", 1), result.err
    return result.err


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return fleet_file(tmp_path, ["tcp://127.0.0.1:9"], interval=1, engine="lease = 1")


def test_an_error_of_the_engine_is_one_line(file, tmp_path, monkeypatch):
    def said(url: str, **environment: str) -> str:
        with monkeypatch.context() as patched:
            for name, value in environment.items():
                patched.setenv(name, value)
            line = failed("poll", file, "--engine", url, "--push")
        assert "secret" not in line
        return line

    nobody = f"nats://127.0.0.1:{free_ports(1)[0]}"
    assert "Connection refused" in said(nobody)
    locked = 'authorization { user: u, password: "right" }\njetstream {}'
    with NatsServers(config=lambda _: locked) as server:
        assert "the server refuses the credentials" in said(
            server.urls, NATS_USER="u", NATS_PASSWORD="secret"
        )
        assert "NATS_CA" in said(server.urls, NATS_CA=str(tmp_path / "gone.pem"))
        assert "does not support TLS" in said(
            server.urls.replace("nats:", "tls:"), NATS_USER="u", NATS_PASSWORD="right"
        )


def test_an_engine_without_jetstream_or_with_another_bucket_is_refused(file):
    with NatsServers(jetstream=False) as server:
        line = failed("poll", file, "--engine", server.urls)
        assert "JetStream is off" in line
    with NatsServers() as server:
        status = ("fleet", "status", "--engine", server.urls)
        line = failed(*status)
        assert "there is no fleet yet; put it there with --push" in line
        server.ask(partial(make_bucket, history=5))
        line = failed("poll", file, "--engine", server.urls)
        assert "bucket modbus-fleet has unexpected settings: history 5, not 1" in line
        server.ask(partial(make_bucket, history=1))
        server.ask(partial(write, key="settings", value=b'{"format": 7}'))
        assert "format 7 is not supported; this version reads format 1" in failed(*status)


async def make_bucket(client: Any, history: int) -> None:
    js = client.jetstream()
    with contextlib.suppress(Exception):
        await js.delete_key_value("modbus-fleet")
    await js.create_key_value(bucket="modbus-fleet", history=history)


async def write(client: Any, key: str, value: bytes) -> None:
    await (await client.jetstream().key_value("modbus-fleet")).put(key, value)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--engine", "http://x"], "not 'http://x'"),
        (["--engine", "nats://h:0"], "the port must be in 1..65535: 'nats://h:0'"),
        (["--engine", ","], "engine: 1..32 URLs"),
        (["--push"], "--push needs --engine"),
        (["--engine", "nats://h", "--once"], "--once cannot be used with --engine"),
        (["--engine", "nats://h", "--zone", "a.b"], "zone 'a.b' must be 1..60 letters"),
    ],
)
def test_wrong_usage_is_reported_before_a_request_is_sent(file, options, message):
    line = failed("poll", file, *options, code=2)
    assert message in line
    assert "secret" not in line


async def requested(client: Any, subject: str, value: bytes) -> dict[str, Any]:
    answer: dict[str, Any] = json.loads((await client.request(subject, value, timeout=10)).data)
    return answer


def mosquitto(port: int, topic: str) -> subprocess.Popen[str]:
    command = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(port), "-t", topic, "-C", "1"]
    return subprocess.Popen([*command, "-W", "20"], stdout=subprocess.PIPE, text=True)


@pytest.mark.timeout(300)
def test_outcomes_and_commands_and_status_use_the_engine(tmp_path):
    mqtt = free_ports(1)[0]
    engine = "lease = 2\ncommands = true"
    with (
        NatsServers(config=lambda _: MQTT.format(port=mqtt)) as server,
        asked_devices(1) as (urls, devices),
    ):
        file = fleet_file(tmp_path, urls, interval=0.2, engine=engine)
        # A worker whose standard output is closed ends as every command does: silently, with 1.
        unread, pipe = os.pipe()
        os.close(unread)
        command = [sys.executable, "-m", "libmodbus_py", "poll", str(file), "--json"]
        command += ["--engine", server.urls]
        result = subprocess.run(command, stdout=pipe, stderr=subprocess.PIPE, text=True, timeout=60)
        os.close(pipe)
        assert result.returncode == 1
        assert "libmodbus-py:" not in result.stderr
        polls = devices.polls
        with Workers(file, tmp_path) as workers:
            workers.start("a", server.urls)
            until(lambda: devices.polls > polls, 30)

            # Commands: one with an answer, and one over MQTT, whose outcome is heard there.
            command_to_write = partial(requested, subject="modbus.write.d0-3.setpoint", value=b"21")
            assert server.ask(command_to_write)["ok"] is True
            outcome = mosquitto(mqtt, "modbus/written/d0-4/setpoint")
            publish = ["mosquitto_pub", "-h", "127.0.0.1", "-p", str(mqtt)]
            publish += ["-t", "modbus/write/d0-4/setpoint", "-m", "12"]

            def is_heard() -> bool:
                """Publish, until whoever listens has subscribed."""
                subprocess.run(publish, check=True)
                return outcome.poll() is not None

            until(is_heard, 20)
            assert json.loads(outcome.communicate(timeout=30)[0])["ok"] is True

            # What cannot be read is told.
            server.ask(partial(write, key="worker.x.y", value=b"[" * 5000))
            command = ("fleet", "status", "--engine", server.urls)
            answer = run(*command, "--json")
            assert answer.out, answer.err
            status = json.loads(answer.out)
            assert len(status["unreadable"]) == 1
            (here,) = (worker for worker in status["workers"] if worker["state"] == "here")
            assert here["id"].startswith("a.")
            assert here["devices"] == UNITS

            # A zone that nobody serves.
            fleet_file(tmp_path, urls, interval=0.2, engine=engine, zone="north")
            assert run("poll", file, "--engine", server.urls, "--push").code == 0
            result = run(*command)
            assert result.code == 1
            assert "no worker polls zone 'north'" in result.err
            assert any(line.endswith("  no worker") for line in result.out.splitlines())
            reply = server.ask(command_to_write)
            assert reply["error"] == "no worker polls 'd0-3' now"
        assert devices.doubles == 0
