"""
One worker, step by step: what it writes, what it polls, and when. Times are in a list.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest

from libmodbus_py.services.workers.records import (
    SETTINGS,
    Connection,
    FleetSettings,
    Holding,
    Member,
    decode,
    encode_holder,
)
from libmodbus_py.services.workers.view import Entry
from libmodbus_py.services.workers.worker import Put, Worker

LEASE = 10.0
LINE = Connection("", "tcp:192.0.2.1:502", 1.0, '{"devices": []}')
OTHER = Connection("", "tcp:192.0.2.2:502", 1.0, '{"devices": []}')


class Bucket:
    """A bucket that one worker sees at once, and whose other workers are lines of a test."""

    def __init__(
        self, *connections: Connection, settings: FleetSettings | None = None, name: str = "m"
    ) -> None:
        ids = (f"{name}.{number}" for number in itertools.count(1))
        self.worker = Worker(lambda: next(ids), {""})
        self.latest: dict[str, Entry] = {}
        self.revision = 0
        self.is_told = True
        self.worker.begins()
        self.write(SETTINGS, (settings or FleetSettings(LEASE)).encode())
        for each in connections:
            self.write(each.bucket_key, each.encode())
        self.worker.is_synced(0.0)

    @property
    def me(self) -> str:
        return self.worker.lease.id

    def write(self, key: str, value: bytes | None, at: float = 0.0) -> None:
        self.revision += 1
        self.latest[key] = Entry(key, value, self.revision)
        if self.is_told:
            self.worker.saw(self.latest[key], at)

    def member(self, id: str, at: float, state: Any = "here", seen: int | None = None) -> None:
        known = self.revision if seen is None else seen
        beat = self.revision
        self.write(f"worker.{id}", Member(id, state, ("",), LEASE, beat, known).encode(), at)

    def hold(self, connection: Connection, holder: str, at: float = 0.0, by: str = "") -> None:
        self.write(connection.slot.key, encode_holder(holder, by or holder), at)

    def read_again(self, at: float) -> None:
        """The worker reads all that the bucket contains."""
        self.worker.begins()
        for entry in sorted(self.latest.values(), key=lambda each: each.revision):
            self.worker.saw(entry, at)
        self.worker.is_synced(at)

    def step(self, at: float) -> list[Put]:
        """One step whose writes all succeed; return those that are not about its own lease."""
        told = []
        is_early, active = at < self.worker.due, self.worker.active
        puts = self.worker.step(at)
        assert not is_early or (puts, self.worker.active) == ([], active), "it was due"
        for put in puts:
            known = self.latest.get(put.key)
            assert put.last == (known.revision if known else 0)
            self.write(put.key, put.value, at)
            if not put.beat:
                told.append(put)
        return told

    def steps(self, *times: float) -> list[Put]:
        return [put for at in times for put in self.step(at)]

    def polled(self) -> set[str]:
        return set(self.worker.active)


def written(puts: list[Put]) -> dict[str, Any]:
    """Return what stands in writes: the state of a worker, the holder of a slot, or None."""
    found: dict[str, Any] = {}
    for put in puts:
        record = decode(put.key, put.value) if put.value is not None else None
        if isinstance(record, Member):
            found[put.key] = record.state
        else:
            found[put.key] = record.holder if isinstance(record, Holding) else None
    return found


def every(start: float, end: float, pause: float = 1.0) -> list[float]:
    return [start + pause * at for at in range(int((end - start) / pause) + 1)]


class TestSnapshot:
    def test_a_bucket_counts_when_it_is_whole(self) -> None:
        worker = Worker(lambda: "m.1", {""})
        worker.begins()
        assert worker.is_reading
        worker.saw(Entry(SETTINGS, FleetSettings(LEASE).encode(), 1), 0.0)
        assert worker.view.settings is None
        assert worker.step(0.0) == []
        worker.is_synced(0.0)
        assert not worker.is_reading
        assert worker.view.settings == FleetSettings(LEASE)
        assert worker.due == -math.inf
        (put,) = worker.step(0.0)
        assert (put.key, put.last, put.beat) == ("worker.m.1", 0, 1)

    def test_the_end_of_what_did_not_begin_is_none(self) -> None:
        bucket = Bucket(LINE)
        view = bucket.worker.view
        bucket.worker.is_synced(5.0)
        assert bucket.worker.view is view

    def test_nothing_is_written_before_there_are_settings(self) -> None:
        worker = Worker(lambda: "m.1", {""})
        worker.begins()
        worker.is_synced(0.0)
        assert worker.step(0.0) == []
        assert worker.due == math.inf

    def test_a_bucket_that_went_back_is_another_one(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 15.0))
        assert bucket.polled() == {LINE.key}
        bucket.worker.begins()
        bucket.worker.saw(Entry(SETTINGS, FleetSettings(LEASE).encode(), 1), 15.0)
        bucket.worker.is_synced(15.0)
        assert bucket.me == "m.2"
        assert bucket.polled() == set()
        assert not bucket.worker.may_ask(LINE.key, 15.0)

    def test_a_bucket_that_is_read_again_changes_nothing(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 15.0))
        bucket.read_again(15.0)
        assert bucket.me == "m.1"
        bucket.step(15.0)
        assert bucket.polled() == {LINE.key}
        assert bucket.worker.may_ask(LINE.key, 15.0)

    def test_a_bucket_that_is_read_again_prolongs_no_lease_of_others(self) -> None:
        bucket = Bucket()
        bucket.member("o.1", 0.0)
        bucket.steps(*every(0.0, 8.0))
        bucket.read_again(8.0)
        assert bucket.steps(9.0, 10.0) == []
        assert written(bucket.steps(11.0)) == {"worker.o.1": "ended"}


class TestLeaving:
    def test_who_leaves_polls_nothing_and_says_that_it_has_ended(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 15.0))
        bucket.worker.leave()
        assert bucket.polled() == set()
        assert bucket.worker.due == -math.inf
        assert not bucket.worker.left
        (put,) = bucket.worker.step(15.2)
        assert written([put]) == {"worker.m.1": "ended"}
        bucket.write(put.key, put.value, 15.2)
        assert bucket.worker.left
        assert bucket.worker.step(16.0) == []

    def test_the_confirmation_of_its_last_word_extends_no_lease(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 15.0))
        until = bucket.worker.lease.until
        bucket.worker.leave()
        (put,) = bucket.worker.step(15.2)
        bucket.worker.was_written(put, bucket.revision + 1)
        assert bucket.worker.lease.until == until


class TestLease:
    def test_a_confirmation_counts_for_its_own_beat_only(self) -> None:
        bucket = Bucket(LINE)
        bucket.step(0.0)
        bucket.is_told = False
        (put,) = bucket.worker.step(1.0)
        for other in (put._replace(beat=0), put._replace(key="worker.b.1")):
            bucket.worker.was_written(other, 50)
            assert bucket.worker.lease.until == 9.0
        bucket.worker.was_written(put, 50)
        assert bucket.worker.lease.until == 10.0

    def test_a_request_must_be_over_before_the_lease(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 12.0))
        assert bucket.worker.lease.until == 21.0
        assert bucket.worker.may_ask(LINE.key, 19.9)
        assert not bucket.worker.may_ask(LINE.key, 20.0)
        assert not bucket.worker.may_ask(OTHER.key, 12.0)

    def test_without_the_engine_it_may_go_on(self) -> None:
        settings = FleetSettings(LEASE, "continue")
        bucket = Bucket(LINE, settings=settings)
        bucket.steps(*every(0.0, 12.0))
        assert bucket.worker.may_ask(LINE.key, 1000.0)
        assert not bucket.worker.may_ask(OTHER.key, 12.0)
        bucket.write(SETTINGS, FleetSettings(LEASE, "stop").encode(), 12.0)
        bucket.member("b.1", 12.0)
        assert not bucket.worker.may_ask(LINE.key, 1000.0)

    def test_who_was_said_to_have_ended_joins_again_under_another_id(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 12.0))
        bucket.member("m.1", 12.0, "ended")
        assert bucket.me == "m.2"
        assert not bucket.worker.left
        assert bucket.polled() == set()
        assert bucket.worker.due == -math.inf

    def test_whose_record_was_deleted_joins_again_too(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(*every(0.0, 12.0))
        bucket.write("worker.m.1", None, 12.0)
        assert bucket.me == "m.2"

    def test_a_worker_is_heard_for_half_of_its_lease(self) -> None:
        bucket = Bucket()
        bucket.member("b.1", 5.0)
        here = bucket.worker.view.members["b.1"]
        assert bucket.worker.is_heard(here, 9.9)
        assert not bucket.worker.is_heard(here, 10.0)
        bucket.member("b.1", 9.0, "ended")
        assert not bucket.worker.is_heard(bucket.worker.view.members["b.1"], 9.1)


class TestSlots:
    def test_a_free_slot_is_taken_after_a_lease(self) -> None:
        """Somebody unknown may hold it, for whatever the bucket has forgotten."""
        bucket = Bucket(LINE)
        assert bucket.steps(*every(0.0, 10.4, 0.1)) == []
        (put,) = bucket.step(10.5)
        assert (put.key, put.last) == (LINE.slot.key, 0)
        assert written([put]) == {LINE.slot.key: "m.1"}
        bucket.step(10.6)
        assert bucket.polled() == {LINE.key}

    def test_the_slot_of_an_ended_worker_is_taken_at_once(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("b.1", 0.0, "ended")
        bucket.hold(LINE, "b.1")
        assert written(bucket.steps(0.0, 0.1)) == {LINE.slot.key: "m.1"}

    def test_a_worker_whose_lease_is_over_has_ended_and_its_slots_are_taken(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("b.1", 0.0)
        bucket.hold(LINE, "b.1")
        assert bucket.steps(*every(0.0, 10.4, 0.1)) == []
        puts = bucket.steps(10.5, 10.6)
        assert written(puts) == {"worker.b.1": "ended", LINE.slot.key: "m.1"}

    def test_who_stood_still_waits_a_lease_before_it_says_that_others_ended(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("o.1", 0.0)
        bucket.hold(LINE, "o.1")
        bucket.steps(*every(0.0, 2.0))
        # It sees its own values again, and so would have seen those of others from here on.
        assert bucket.steps(*every(31.0, 41.0)) == []
        assert written(bucket.steps(*every(42.0, 43.0)))["worker.o.1"] == "ended"

    def test_a_slot_is_handed_over_and_polled_no_more(self) -> None:
        bucket = Bucket(LINE, OTHER)
        bucket.steps(*every(0.0, 12.0))
        assert bucket.polled() == {LINE.key, OTHER.key}
        bucket.member("b.1", 12.0)
        puts = bucket.worker.step(12.1)
        (slot,) = (put for put in puts if not put.beat)
        (moved,) = (each for each in (LINE, OTHER) if each.slot.key == slot.key)
        assert written([slot]) == {moved.slot.key: "b.1"}
        assert bucket.polled() == {LINE.key, OTHER.key} - {moved.key}

    def test_a_write_is_repeated_after_a_fifth_of_a_lease_or_a_change(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("b.1", 0.0, "ended")
        bucket.hold(LINE, "b.1")
        (beat,) = bucket.worker.step(0.0)
        bucket.write(beat.key, beat.value, 0.0)

        def asked(at: float) -> bool:
            """True if it writes the slot, which does not arrive."""
            return LINE.slot.key in {put.key for put in bucket.worker.step(at)}

        assert [asked(at) for at in (0.1, 0.2, 2.0)] == [True, False, False]
        assert asked(2.1)
        bucket.hold(LINE, "b.1", 2.2)
        assert asked(2.3)

    def test_after_three_writes_in_vain_all_is_read_again(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("b.1", 0.0, "ended")
        bucket.hold(LINE, "b.1")
        (beat,) = bucket.worker.step(0.0)
        bucket.write(beat.key, beat.value, 0.0)
        blind = []
        for at in (0.1, 2.2, 4.3):
            bucket.worker.saw(Entry(beat.key, beat.value, bucket.revision + int(at) + 1), at)
            bucket.worker.step(at)
            blind.append(bucket.worker.is_blind(at))
        assert blind == [False, False, True]


class TestAcknowledgements:
    def test_a_connection_waits_until_all_others_have_seen_it(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("b.1", 0.0, seen=0)
        bucket.hold(LINE, "m.1", by="m.1")
        bucket.step(0.0)
        assert bucket.worker.waiting == {LINE.key}
        assert bucket.polled() == set()
        touched = bucket.worker.view.touched_at(LINE)
        bucket.member("b.1", 0.5, seen=touched - 1)
        bucket.step(0.5)
        assert bucket.polled() == set()
        bucket.member("b.1", 0.6, seen=touched)
        bucket.step(0.6)
        assert bucket.polled() == {LINE.key}
        assert bucket.worker.waiting == set()

    def test_who_has_vanished_is_waited_for_as_long_as_its_lease(self) -> None:
        bucket = Bucket(LINE)
        bucket.member("b.1", 0.0)
        bucket.step(0.0)
        bucket.write("worker.b.1", None, 1.0)
        bucket.hold(LINE, "m.1", 1.0, by="m.1")
        for at in every(1.0, 11.4, 0.1):
            bucket.step(at)
            assert bucket.polled() == set(), at
        bucket.step(11.5)
        assert bucket.polled() == {LINE.key}

    def test_a_beat_is_hurried_when_others_wait_for_it(self) -> None:
        bucket = Bucket(LINE)
        bucket.steps(0.0, 1.0)
        assert bucket.worker.step(1.5) == []
        bucket.write(OTHER.bucket_key, OTHER.encode(), 1.5)
        (put,) = bucket.worker.step(1.5)
        assert put.beat
        assert isinstance(record := decode(put.key, put.value or b""), Member)
        assert record.seen == bucket.revision
        assert (record.zones, record.lease, record.state) == (("",), LEASE, "here")


class TestEndedWorkers:
    """They stay for `fleet status` for a minute; then the first worker deletes them."""

    def ended(self, name: str = "m") -> Bucket:
        bucket = Bucket(name=name)
        bucket.member("z.1", 0.0, "ended")
        return bucket

    def test_they_are_deleted_after_a_minute(self) -> None:
        bucket = self.ended()
        assert bucket.steps(*every(0.0, 59.0)) == []
        assert written(bucket.step(60.0)) == {"worker.z.1": None}
        assert bucket.steps(*every(61.0, 65.0)) == []

    @pytest.mark.parametrize(("other", "deletes"), [("a.1", False), ("p.1", True)])
    def test_the_first_worker_deletes_them(self, other: str, deletes: bool) -> None:
        bucket = self.ended()
        puts: list[Put] = []
        for at in every(0.0, 61.0):
            bucket.member(other, at)
            puts += bucket.step(at)
        assert written(puts) == ({"worker.z.1": None} if deletes else {})

    def test_who_ended_itself_is_not_the_first(self) -> None:
        bucket = self.ended()
        bucket.member("a.1", 30.0, "ended")
        assert written(bucket.steps(*every(0.0, 61.0))) == {"worker.z.1": None}

    def test_slots_without_connections_are_deleted_before(self) -> None:
        bucket = self.ended()
        bucket.hold(LINE, "z.1")
        puts = bucket.steps(*every(0.0, 61.0))
        assert [put.key for put in puts] == [LINE.slot.key, "worker.z.1"]
        assert {put.value for put in puts} == {None}
