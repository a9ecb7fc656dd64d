"""What `fleet status` says, of a bucket on a simulated server."""

import asyncio
import json
from typing import Any

import pytest

from libmodbus_py.services.engine.connection import EngineError
from libmodbus_py.services.fleet.config import devices_to_json
from libmodbus_py.services.workers.contents import fleet_status, is_polled, tables
from libmodbus_py.services.workers.records import (
    SETTINGS,
    Connection,
    FleetSettings,
    Member,
    digest_of,
)
from tests.services.workers.simulated import encode_holder
from tests.simulation.engine import Engine
from tests.simulation.network import Network

LEASE = 8.0

KEY = "tcp:192.0.2.9:502"

REPORT = {"connections": 2, "devices": 3, "up": 2, "down": 1, "polls": 1.26}


def connection(zone: str, host: int) -> Connection:
    return Connection(zone, f"tcp:192.0.2.{host}:502", 1.0, devices_to_json([]))


def member(id: str, *, beat: int = 1, state: Any = "here", report: Any = REPORT) -> Member:
    return Member(id, state, ("", "north"), LEASE, beat, 0, report)


def plant() -> tuple[Network, Engine]:
    """Three workers, of whom one is silent and one has ended; connections in three zones."""
    network, engine = empty()
    for request in (
        *(connection("", 1), connection("north", 2), connection("south", 3)),
        *(member("alive.1"), member("silent.2"), member("ended.3", state="ended")),
    ):
        engine.write(request.bucket_key, request.encode())
    for zone, host, worker in (("", 1, "alive.1"), ("north", 2, "silent.2")):
        slot = connection(zone, host).slot
        engine.write(slot.key, encode_holder(worker, worker))
    engine.write("worker.odd.4", b"{}")
    return network, engine


def empty(settings: bytes | None = FleetSettings(LEASE).encode()) -> tuple[Network, Engine]:
    network = Network()
    engine = Engine(network)
    if settings:
        engine.write(SETTINGS, settings)
    return network, engine


def status_of(network: Network, engine: Engine, report: Any = REPORT) -> dict[str, Any]:
    """Look at the fleet for a quarter of a lease, while one of its workers tells of itself."""

    async def main() -> dict[str, Any]:
        client = engine.client()
        looking = asyncio.create_task(fleet_status(engine.bucket(client)))
        await asyncio.sleep(1.0)
        record = member("alive.1", beat=2, report=report)
        # Others may write a NaN, which this package refuses to write.
        engine.write(record.bucket_key, record.encode().replace(b'"NaN"', b"NaN"))
        try:
            return await looking
        finally:
            await client.close()

    began = network.events.now
    status: dict[str, Any] = network.run(main)
    assert network.events.now - began == pytest.approx(LEASE / 4, abs=0.1)
    return status


def test_a_status_has_workers_zones_and_sums() -> None:
    status = status_of(*plant())
    assert [(worker["id"], worker["state"], worker["slots"]) for worker in status["workers"]] == [
        ("alive.1", "here", 1),
        ("ended.3", "ended", 0),
        ("silent.2", "silent", 1),
    ]
    assert status["workers"][0]["zones"] == ["north"]
    assert status["workers"][0].items() >= REPORT.items()
    assert status["zones"] == {
        "": {"connections": 1, "slots": 1, "served_slots": 1, "workers": 1, "unreadable": 0},
        "north": {"connections": 1, "slots": 1, "served_slots": 0, "workers": 1, "unreadable": 0},
        "south": {"connections": 1, "slots": 1, "served_slots": 0, "workers": 0, "unreadable": 0},
    }
    assert status["unreadable"] == ["worker.odd.4: zones is missing"]
    assert not is_polled(status)


@pytest.mark.parametrize(
    ("zone", "value", "why"),
    [
        ("", {"connection": KEY, "timeout": 1, "devices": {}}, f"{KEY}: its devices in the bucket"),
        ("west", {"connection": "tcp:x", "timeout": 1, "devices": {}}, "connection does not match"),
        ("", None, ""),
    ],
)
def test_an_unreadable_record_is_shown_as_not_polled(zone: str, value: object, why: str) -> None:
    network, engine = empty()
    first = connection("", 1)
    engine.write(first.bucket_key, first.encode())
    engine.write(first.slot.key, encode_holder("alive.1", "alive.1"))
    if value:
        slot = Connection(zone, KEY, 1.0, "{}").slot
        engine.write(f"connection.{zone or '_'}.{digest_of(KEY)}", json.dumps(value).encode())
        engine.write(slot.key, encode_holder("alive.1", "alive.1"))
    status = status_of(network, engine)
    assert is_polled(status) == (not value)
    assert len(status["unreadable"]) == bool(value)
    if value:
        assert why in status["unreadable"][0]
        assert status["zones"][zone]["unreadable"] == 1
        assert "  1 unreadable\n" in tables(status)


def test_tables_of_the_status_for_people() -> None:
    status = status_of(*plant())
    status["workers"][0]["zones"] = ["east", "north"]
    status["workers"][1]["id"] = "e" * 30
    status["zones"]["z" * 30] = status["zones"].pop("south")
    assert (
        tables(status)
        == f"""\
worker                       state   slots connections devices     up   down  polls/s  zones
alive.1                      here        1           2       3      2      1     1.26  east, north
{"e" * 28} ended       0           2       3      2      1     1.26  north
silent.2                     silent      1           2       3      2      1     1.26  north

zone                         workers connections slots served
(none)                             1           1     1      1
north                              1           1     1      0  moving
{"z" * 28}       0           1     1      0  no worker
unreadable: worker.odd.4: zones is missing"""
    )


def test_invalid_numbers_of_a_report_count_as_zero() -> None:
    status = status_of(*plant(), report={"polls": "many", "up": "NaN", "down": 2})
    numbers = {"connections": 0, "devices": 0, "up": 0, "down": 2, "polls": 0}
    assert status["workers"][0].items() >= numbers.items()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (None, "there is no fleet yet; put it there with --push"),
        (b'{"format": 99}', "settings: format 99 is not supported; this version reads format 1"),
    ],
)
def test_a_bucket_without_a_fleet_has_no_status(settings: bytes | None, message: str) -> None:
    with pytest.raises(EngineError) as refused:
        status_of(*empty(settings))
    assert str(refused.value) == f"modbus-fleet: {message}"
