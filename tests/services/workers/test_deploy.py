"""
The files in deploy/: three servers with TLS between them, a worker and a viewer who prove who
they are; and what their own tools say to them.
"""

import asyncio
import json
import re
import shutil
import signal
import ssl
import subprocess
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from fuzz.asked_devices import UNITS, Workers, asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers, free_ports
from libmodbus_py.cli.main import main
from libmodbus_py.services.workers.records import BUCKET
from tests.support.programs import program

pytest.importorskip("nats")

# Servers elect a leader within ten seconds, on a machine that does nothing else.
PATIENCE = 90.0

POLLER = {"NATS_USER": "poller", "NATS_PASSWORD": "POLLER_PASSWORD-x"}

DEPLOY = Path(__file__).parents[3] / "deploy"


@pytest.mark.timeout(300)
def test_the_configuration_of_nats_is_valid(tmp_path, monkeypatch, capsys):
    """And a worker waits for servers that are still starting, and bears the loss of a leader."""
    assert main(["certificates", str(tmp_path), "127.0.0.1"]) == 0
    certificates = tmp_path / "127.0.0.1"
    ca = tmp_path / "ca.pem"
    trusting = ssl.create_default_context(cafile=ca)
    trusting.verify_flags |= ssl.VERIFY_X509_STRICT  # as from Python 3.13 on
    for name in ("POLLER_PASSWORD", "VIEWER_PASSWORD"):
        monkeypatch.setenv(name, f"{name}-x")
    for name in ("NATS_NAME", "NATS_ROUTE_1", "NATS_ROUTE_2"):
        monkeypatch.setenv(name, "nats-route://127.0.0.1:1")
    for name, value in POLLER.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("NATS_CA", str(ca))
    monkeypatch.setattr("libmodbus_py.cli.serve.fleet.ELECTION", 0.5)
    mqtt = free_ports(3)

    def config(number: int) -> str:
        """As it stands, but for places and ports: three share a machine here."""
        text = (DEPLOY / "nats-server.conf").read_text().replace("/etc/nats", str(certificates))
        text = text.replace("0.0.0.0:8883", f"127.0.0.1:{mqtt[number]}")
        return re.sub(r"\n  (routes|store_dir): .*", "", text)

    with NatsServers(3, config=config) as servers, asked_devices(1) as (urls, devices):
        # They may have elected a leader meanwhile, who is not the same after a new start.
        for number in range(3):
            servers.kill(number)
        servers.start(0)
        file = fleet_file(tmp_path, urls, interval=0.3, engine="lease = 2")
        engine = servers.urls.replace("nats:", "tls:")
        push = ["poll", str(file), "--engine", engine, "--push"]

        # No leader is elected by one of three.
        assert main(push) == 1
        assert "are most of the servers up?" in capsys.readouterr().err.splitlines()[-1]
        monkeypatch.setenv("NATS_CA", "")
        assert main([*push, "--engine", engine.partition(",")[0]]) == 1
        assert "certificate is not trusted" in capsys.readouterr().err
        monkeypatch.setenv("NATS_CA", str(ca))

        with Workers(file, tmp_path) as workers:
            workers.start("a", engine)
            workers.start("b", engine)
            for name in ("a", "b"):
                until(partial(_is_waiting, workers, name), PATIENCE)
            workers.signal("a", signal.SIGINT)
            assert workers.ended("a", PATIENCE) == 130
            assert "Traceback" not in workers.said("a")
            # With two of three there is a leader, but no place for three copies; two of NATS 2.15
            # that begin anew elect none.
            servers.start(1)
            if nats_version() < (2, 15):
                until(lambda: "too few servers are up" in workers.said("b"), PATIENCE)
            assert devices.polls == 0
            servers.start(2)
            until(lambda: devices.polls > 0, PATIENCE)
            lines = [line for line in workers.said("b").splitlines() if "waiting" in line]
            assert 0 < len(lines) == len(set(lines))

            looking = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(mqtt[0])]
            looking += ["-u", "viewer", "-P", "VIEWER_PASSWORD-x", "-t", "modbus/readings/#"]
            looking += ["--cafile", str(ca), "-C", "1", "-W", "90"]
            result = subprocess.run(looking, capture_output=True, text=True, timeout=120)
            assert json.loads(result.stdout)["values"]["level"]["quality"] == "good", result.stderr
            refused: asyncio.Queue[Exception] = asyncio.Queue()
            login: dict[str, Any] = {"user": "viewer", "password": "VIEWER_PASSWORD-x"}
            servers.ask(
                partial(viewer_may_only_look, refused=refused),
                **login,
                tls=trusting,
                error_cb=refused.put,
            )

            login = {"user": POLLER["NATS_USER"], "password": POLLER["NATS_PASSWORD"]}
            servers.kill(servers.leader(f"KV_{BUCKET}", **login, tls=trusting))
            # A lease that nobody confirms is over by then.
            start = time.monotonic() + 2.0
            until(lambda: devices.since(start) == UNITS, PATIENCE)
            workers.signal("b", signal.SIGTERM)
            assert workers.ended("b", PATIENCE) == 0
        assert devices.doubles == 0


def nats_version() -> tuple[int, ...]:
    command = [program("nats-server"), "--version"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return tuple(map(int, re.findall(r"\d+", text)[:2]))


def _is_waiting(workers: Workers, name: str) -> bool:
    text = workers.said(name)
    return "waiting for the engine" in text and ("no leader" in text or "no answer" in text)


async def viewer_may_only_look(client: Any, refused: asyncio.Queue[Exception]) -> None:
    for subject in ("modbus.write.d0-1.setpoint", "$KV.modbus-fleet.settings"):
        await client.publish(subject, b"20")
        assert "permissions violation" in str(await refused.get()).lower()


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="no systemd here")
@pytest.mark.parametrize("command", ["serve", "gateway", "poll", "worker"])
def test_systemd_accepts_the_unit(command, tmp_path):
    unit = tmp_path / f"libmodbus-py-{command}.service"
    text = (DEPLOY / unit.name).read_text()
    # Its program is not installed here.
    unit.write_text(text.replace("/opt/libmodbus-py/bin/libmodbus-py", "/bin/true"))
    result = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)],
        capture_output=True,
        text=True,
        timeout=30,
    )
    lines = [line for line in result.stderr.splitlines() if unit.name in line]
    assert lines == []


def test_files_in_the_compose_file_are_explained():
    """The client for compose files is not a package of Debian; names at least must be right."""
    text = (DEPLOY / "compose.yaml").read_text()
    conf = (DEPLOY / "nats-server.conf").read_text()
    for path in re.findall(r'_file: "(/etc/nats/[\w.-]+)"', conf):
        assert f":{path}:ro" in text
    assert "- nats:/var/lib/nats\n" in text
    variables = set(re.findall(r'(?<!")\$([A-Z_0-9]+)', conf)) | {"NATS_NAME"}
    example = (DEPLOY / "nats.env.example").read_text()
    assert variables == set(re.findall(r"^([A-Z_0-9]+)=", example, re.MULTILINE))
