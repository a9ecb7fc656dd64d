"""
Workers of the real command line on a real nats-server: none of their devices is asked by two,
whoever dies, stops or leaves. All that they decide is tried in `test_whole_workers`.
"""

import signal
import time

import pytest

from fuzz.asked_devices import UNITS, Workers, asked_devices, fleet_file, until
from fuzz.nats_servers import NatsServers
from libmodbus_py.cli.main import main

pytest.importorskip("nats")

# Nothing here is measured in seconds: on a busy machine leases are lost, and taken again.
LEASE = 1.0
INTERVAL = 0.2
PATIENCE = 60.0

CONNECTIONS = 8
DEVICES = CONNECTIONS * UNITS


@pytest.mark.timeout(300)
def test_no_device_is_polled_by_two_workers_when_workers_die_stop_or_leave(tmp_path, capsys):
    with NatsServers() as server, asked_devices(CONNECTIONS) as (urls, devices):
        file = fleet_file(tmp_path, urls, interval=INTERVAL, engine=f"lease = {LEASE}")

        def all_asked() -> None:
            now = time.monotonic()
            until(lambda: devices.since(now) == DEVICES, PATIENCE)

        def shared(before: dict[tuple[str, int], str]) -> bool:
            """Return True if another worker has some of the devices now, and not all."""
            common = before.items() & devices.peers.items()
            return 0 < len(common) < DEVICES

        def joined(name: str) -> None:
            before = dict(devices.peers)
            workers.start(name, server.urls)
            until(lambda: shared(before), PATIENCE)
            all_asked()

        with Workers(file, tmp_path) as workers:
            workers.start("a", server.urls)
            until(lambda: len(devices.peers) == DEVICES, PATIENCE)
            joined("b")

            workers.kill("b")
            all_asked()

            joined("b")
            workers.signal("b", signal.SIGSTOP)
            time.sleep(1.5 * LEASE)
            all_asked()
            workers.signal("b", signal.SIGCONT)
            all_asked()

            workers.signal("b", signal.SIGTERM)
            assert workers.ended("b", PATIENCE) == 0
            all_asked()

            # All that workers rest on is gone; what is put there again is polled again.
            server.ask(lambda client: client.jetstream().delete_key_value("modbus-fleet"))
            until(lambda: "was deleted" in workers.said("a"), PATIENCE)
            until(lambda: devices.since(time.monotonic() - 3 * INTERVAL) == 0, PATIENCE)
            assert main(["poll", str(file), "--engine", server.urls, "--push"]) == 0
            assert f"{CONNECTIONS} new, 0 changed, 0 gone" in capsys.readouterr().out
            all_asked()
            assert "Traceback" not in workers.said("a") + workers.said("b")
        # Whoever is stopped within the call of the system that sends, sends that when it goes on
        # (docs/how-to/several-machines.md): here one process was stopped, once.
        assert devices.doubles <= 1
