"""
Which of several workers speaks for a device that it does not have.
"""

from __future__ import annotations

import pytest

from libmodbus_py.services.workers.locations import Locations
from libmodbus_py.services.workers.records import (
    SETTINGS,
    Connection,
    FleetSettings,
    Member,
    encode_holder,
)
from libmodbus_py.services.workers.view import Entry
from libmodbus_py.services.workers.worker import Worker

LEASE = 10.0
PUMP = Connection("", "tcp:192.0.2.1:502", 0.5, '{"devices": [{"name": "pump"}]}')


class Bucket:
    """What the worker `b.1` has seen, one revision after the other, at time 0."""

    def __init__(self) -> None:
        self.worker = Worker(lambda: "b.1", {""})
        self.revision = 0
        self.worker.begins()
        self.has(SETTINGS, FleetSettings(LEASE).encode())
        self.is_here("b.1")
        self.worker.is_synced(0.0)
        self.locations = Locations(self.worker)

    def has(self, key: str, value: bytes | None) -> None:
        self.revision += 1
        self.worker.saw(Entry(key, value, self.revision), 0.0)

    def is_here(self, id: str, *, state: str = "here") -> None:
        self.has(f"worker.{id}", Member(id, state, ("",), LEASE).encode())  # type: ignore[arg-type]

    def is_held(self, connection: Connection, id: str) -> None:
        self.has(connection.slot.key, encode_holder(id, id))

    def refusal(self, device: str = "pump", now: float = 1.0) -> str:
        return self.locations.refusal(device, now)


@pytest.fixture
def bucket() -> Bucket:
    made = Bucket()
    made.has(PUMP.bucket_key, PUMP.encode())
    return made


def test_a_device_that_nobody_has_is_refused(bucket: Bucket) -> None:
    assert bucket.refusal("valve") == "there is no device 'valve'"


def test_a_device_whose_slot_is_free_is_refused(bucket: Bucket) -> None:
    assert bucket.refusal() == "no worker polls 'pump' now"


def test_the_holder_of_its_slot_answers_itself(bucket: Bucket) -> None:
    bucket.is_here("c.1")
    bucket.is_held(PUMP, "c.1")
    assert bucket.refusal() == ""


def test_a_slot_of_this_worker_does_not_keep_it_from_speaking(bucket: Bucket) -> None:
    """It has the slot, and does not poll the device: nobody else will answer."""
    bucket.is_held(PUMP, "b.1")
    assert bucket.refusal() == "no worker polls 'pump' now"


def test_a_holder_that_has_ended_does_not_answer(bucket: Bucket) -> None:
    bucket.is_here("c.1", state="ended")
    bucket.is_held(PUMP, "c.1")
    assert bucket.refusal() == "no worker polls 'pump' now"


def test_the_first_of_all_workers_speaks_for_them(bucket: Bucket) -> None:
    bucket.is_here("a.1")
    assert bucket.refusal("valve") == ""


def test_whoever_comes_after_this_worker_is_not_asked(bucket: Bucket) -> None:
    bucket.is_here("c.1")
    assert bucket.refusal("valve") == "there is no device 'valve'"


def test_a_worker_that_fell_silent_does_not_speak(bucket: Bucket) -> None:
    """Half a lease without a word of the first: the next one speaks, which is heard."""
    bucket.is_here("a.1")
    bucket.revision += 1
    told = Member("b.1", "here", ("",), LEASE, beat=1)
    bucket.worker.saw(Entry(told.bucket_key, told.encode(), bucket.revision), 4.0)
    assert bucket.refusal("valve", now=4.9) == ""
    assert bucket.refusal("valve", now=5.1) == "there is no device 'valve'"


def test_a_worker_that_hears_nothing_not_even_itself_is_silent(bucket: Bucket) -> None:
    assert bucket.refusal("valve", now=100.0) == ""


def test_devices_that_come_and_go_are_noticed(bucket: Bucket) -> None:
    assert bucket.refusal("pump") == "no worker polls 'pump' now"
    bucket.has(PUMP.bucket_key, None)
    assert bucket.refusal("pump") == "there is no device 'pump'"
    bucket.has(PUMP.bucket_key, PUMP.encode())
    assert bucket.refusal("pump") == "no worker polls 'pump' now"


def test_places_are_not_read_again_for_each_question(
    bucket: Bucket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A flood of questions for thousands of devices must not read them all each time."""
    assert bucket.refusal("pump")
    monkeypatch.setattr("libmodbus_py.services.workers.locations.json.loads", None)
    assert bucket.refusal("pump") == "no worker polls 'pump' now"
