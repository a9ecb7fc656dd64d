"""
Connections that no worker polls are reported once, by the first of all workers.
"""

from __future__ import annotations

import pytest

from libmodbus_py.services.workers.records import (
    Connection,
    FleetSettings,
    Member,
    encode_holder,
)
from libmodbus_py.services.workers.unserved import Unserved
from libmodbus_py.services.workers.view import Entry
from libmodbus_py.services.workers.worker import Worker

LEASE = 10.0
LINE = Connection("north", "tcp:192.0.2.1:502", 1.0, '{"devices": []}')
OTHER = Connection("south", "tcp:192.0.2.2:502", 1.0, '{"devices": []}')


class Bucket:
    """What one worker sees, with workers that renew their leases whenever time passes."""

    def __init__(self, id: str = "a.1") -> None:
        self.worker = Worker(lambda: id, {""})
        self.unserved = Unserved(self.worker)
        self.living = {id}
        self.revision = 0
        self.worker.begins()
        self.see("settings", FleetSettings(LEASE).encode())
        for each in (LINE, OTHER):
            self.see(each.bucket_key, each.encode())
        self.worker.is_synced(0.0)

    def see(self, key: str, value: bytes | None, at: float = 0.0) -> None:
        self.revision += 1
        self.worker.saw(Entry(key, value, self.revision), at)

    def hold(self, connection: Connection, holder: str) -> None:
        self.see(connection.slot.key, encode_holder(holder, holder))

    def found(self, at: float) -> list[str]:
        for id in sorted(self.living):
            member = Member(id, "here", ("",), LEASE, self.revision)
            self.see(member.bucket_key, member.encode(), at)
        return sorted(each.key for each in self.unserved.found(at))


BOTH = sorted((LINE.key, OTHER.key))


@pytest.fixture
def bucket() -> Bucket:
    return Bucket()


def test_what_nobody_polls_for_two_leases_is_reported_once(bucket: Bucket) -> None:
    assert [bucket.found(at) for at in (0.0, 10.0, 20.0, 22.5, 25.0)] == [[], [], [], BOTH, []]


def test_it_looks_four_times_in_a_lease(bucket: Bucket) -> None:
    assert [bucket.found(at) for at in (0.0, 19.0, 20.1, 21.4, 21.5)] == [[], [], [], [], BOTH]


def test_what_is_polled_is_not_reported(bucket: Bucket) -> None:
    bucket.hold(LINE, "a.1")
    assert [bucket.found(at) for at in (0.0, 22.5)] == [[], [OTHER.key]]


def test_what_is_polled_in_between_is_waited_for_again_and_reported_again(bucket: Bucket) -> None:
    assert [bucket.found(at) for at in (0.0, 22.5)] == [[], BOTH]
    bucket.hold(LINE, "a.1")
    assert bucket.found(25.0) == []
    bucket.see(LINE.slot.key, None)
    assert [bucket.found(at) for at in (30.0, 50.0, 52.5)] == [[], [], [LINE.key]]


def test_a_holder_counts_as_long_as_it_is_heard(bucket: Bucket) -> None:
    bucket.hold(LINE, "b.1")
    bucket.hold(OTHER, "a.1")
    bucket.living.add("b.1")
    assert [bucket.found(at) for at in (0.0, 22.5, 45.0)] == [[], [], []]
    bucket.living.remove("b.1")  # heard until half of its lease is over
    assert [bucket.found(at) for at in (47.5, 50.0, 70.0, 72.5)] == [[], [], [], [LINE.key]]


def test_the_first_of_all_workers_reports() -> None:
    second = Bucket("b.1")
    second.living.add("a.1")
    assert [second.found(at) for at in (0.0, 22.5, 45.0)] == [[], [], []]
    second.living.remove("a.1")  # for whom it waits as for a connection
    assert [second.found(at) for at in (47.5, 50.0, 70.0, 72.5)] == [[], [], [], BOTH]


def test_who_is_not_the_first_any_more_forgets_what_it_found() -> None:
    second = Bucket("b.1")
    assert [second.found(at) for at in (0.0, 22.5)] == [[], BOTH]
    second.living.add("a.1")
    assert second.found(25.0) == []
    second.living.remove("a.1")
    assert [second.found(at) for at in (30.0, 50.0, 52.5)] == [[], [], BOTH]


def test_a_bucket_without_settings_has_no_connections_to_report() -> None:
    worker = Worker(lambda: "a.1", {""})
    assert Unserved(worker).found(100.0) == []
