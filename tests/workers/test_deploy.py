"""
The files in deploy/: three servers with TLS between them, a worker and a viewer who prove who
they are; and what their own tools say to them.
"""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.asked_devices import asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers, free_ports

nats = pytest.importorskip("nats")

DEPLOY = Path(__file__).parents[2] / "deploy"


@pytest.mark.timeout(300)
def test_the_configuration_of_nats_works_as_it_stands(tmp_path, monkeypatch):
    subprocess.run(
        [str(DEPLOY / "certificates.sh"), str(tmp_path), "127.0.0.1"], check=True, timeout=30
    )
    certificates = tmp_path / "127.0.0.1"
    for name in ("POLLER_PASSWORD", "VIEWER_PASSWORD"):
        monkeypatch.setenv(name, f"{name}-x")
    for name in ("NATS_NAME", "NATS_ROUTE_1", "NATS_ROUTE_2"):
        monkeypatch.setenv(name, "nats-route://127.0.0.1:1")
    mqtt = free_ports(3)

    def config(number: int) -> str:
        """As it stands, but for places and ports: three share a machine here."""
        text = (DEPLOY / "nats-server.conf").read_text().replace("/etc/nats", str(certificates))
        text = text.replace("0.0.0.0:8883", f"127.0.0.1:{mqtt[number]}")
        return re.sub(r"\n  (routes|store_dir): .*", "", text)

    with NatsServers(3, config=config) as servers, asked_devices(1) as (urls, asked):
        file = fleet_file(tmp_path, urls, interval=0.3, engine="lease = 2")
        engine = servers.urls.replace("nats:", "tls:")
        environment = {
            **os.environ,
            "NATS_USER": "poller",
            "NATS_PASSWORD": "POLLER_PASSWORD-x",
            "NATS_CA": str(tmp_path / "ca.pem"),
        }
        command = [sys.executable, "-m", "libmodbus_py", "poll", str(file), "--engine", engine]

        def is_pushed() -> bool:
            # Until the servers have found each other.
            return not subprocess.run(
                [*command, "--push"], env=environment, capture_output=True, timeout=30
            ).returncode

        until(is_pushed, 40)
        untrusted = subprocess.run(
            [*command, "--push"],
            env={**environment, "NATS_CA": ""},
            capture_output=True,
            text=True,
            timeout=30,
        )
        assert untrusted.returncode == 1
        assert "certificate is not trusted" in untrusted.stderr
        worker = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
        try:
            until(lambda: asked.polls > 0, 30)
            looking = ["mosquitto_sub", "-h", "127.0.0.1", "-p", str(mqtt[0])]
            looking += ["-u", "viewer", "-P", "VIEWER_PASSWORD-x", "-t", "modbus/readings/#"]
            looking += ["--cafile", str(tmp_path / "ca.pem"), "-C", "1", "-W", "20"]
            heard = subprocess.run(looking, capture_output=True, text=True, timeout=30)
            assert json.loads(heard.stdout)["values"]["level"]["quality"] == "good", heard.stderr
            asyncio.run(_viewer_may_only_look(engine, tmp_path / "ca.pem"))
        finally:
            worker.terminate()
            worker.communicate(timeout=20)
        assert worker.returncode == 0


async def _viewer_may_only_look(engine: str, ca: Path) -> None:
    import ssl

    refused: list[str] = []
    trusting = ssl.create_default_context(cafile=ca)
    trusting.verify_flags |= ssl.VERIFY_X509_STRICT  # as from Python 3.13 on

    async def note(error: Exception) -> None:
        refused.append(str(error))

    client = await nats.connect(
        engine.split(","),
        user="viewer",
        password="VIEWER_PASSWORD-x",
        tls=trusting,
        error_cb=note,
    )
    try:
        for subject in ("modbus.write.d0-1.setpoint", "$KV.modbus-fleet.settings"):
            await client.publish(subject, b"20")
        await client.flush()
        until_two = 100
        while len(refused) < 2 and until_two:
            until_two -= 1
            await asyncio.sleep(0.05)
        assert len(refused) == 2
        assert all("permissions violation" in each.lower() for each in refused)
    finally:
        await client.close()


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="no systemd here")
def test_systemd_takes_the_unit(tmp_path):
    text = (DEPLOY / "libmodbus-py-poll.service").read_text()
    unit = tmp_path / "libmodbus-py-poll.service"
    # Its program is not installed here.
    unit.write_text(text.replace("/opt/libmodbus-py/bin/libmodbus-py", "/bin/true"))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=30
    )
    told = [line for line in done.stderr.splitlines() if unit.name in line]
    assert told == []


def test_what_compose_mounts_and_reads_is_explained_beside_it():
    """The client for compose files is no package of Debian; names at least must be right."""
    text = (DEPLOY / "compose.yaml").read_text()
    conf = (DEPLOY / "nats-server.conf").read_text()
    for path in re.findall(r'_file: "(/etc/nats/[\w.]+)"', conf):
        assert f":{path}:ro" in text
    assert "- nats:/var/lib/nats\n" in text
    variables = set(re.findall(r'(?<!")\$([A-Z_0-9]+)', conf)) | {"NATS_NAME"}
    example = (DEPLOY / "nats.env.example").read_text()
    assert variables == set(re.findall(r"^([A-Z_0-9]+)=", example, re.MULTILINE))
