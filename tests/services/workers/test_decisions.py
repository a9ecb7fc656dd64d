"""The decisions of a worker at each look at its clock: its writes and its polls."""

import math
from typing import Any

import pytest

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.workers.decisions import step
from libmodbus_py.services.workers.records import SETTINGS, Connection, FleetSettings, Member
from libmodbus_py.services.workers.worker import Worker
from tests.services.workers.simulated import LEASE, OneWorker, every, records

LINE = Connection("", "tcp:192.0.2.1:502", 1.0, '{"devices": [{"name": "pump"}]}')
OTHER = Connection("", "tcp:192.0.2.2:502", 1.0, '{"devices": []}')
NORTH = Connection("north", "tcp:192.0.2.1:502", 1.0, '{"devices": []}')


def at_work(*connections: Connection, until: float = 12.0, **options: Any) -> OneWorker:
    """Return a worker that has polled these connections for a while."""
    one = OneWorker(*connections, **options)
    one.steps(*every(0.0, until))
    assert one.polled() == {connection.key for connection in connections}
    return one


def beside_ended() -> OneWorker:
    """Return a worker that can take a slot of a worker that has ended."""
    one = OneWorker(LINE)
    one.member("b.1", 0.0, "ended")
    one.hold(LINE, "b.1")
    return one


class TestSnapshot:
    def test_a_bucket_is_used_once_it_is_complete(self) -> None:
        worker = Worker(lambda: "m.1", {""})
        worker.begin_snapshot()
        assert worker.is_reading
        worker.add_change(Change(SETTINGS, FleetSettings(LEASE).encode(), 1), 0.0)
        assert worker.view.settings is None
        assert step(worker, 0.0).puts == ()
        worker.end_snapshot(0.0)
        assert not worker.is_reading
        assert worker.view.settings == FleetSettings(LEASE)
        assert worker.due == -math.inf
        (put,) = step(worker, 0.0).puts
        assert (put.key, put.last) == ("worker.m.1", 0)

    def test_a_restored_older_bucket_ends_all_leases(self) -> None:
        one = at_work(LINE)
        one.worker.begin_snapshot()
        one.worker.add_change(Change(SETTINGS, FleetSettings(LEASE).encode(), 1), 15.0)
        one.worker.end_snapshot(15.0)
        assert one.me == "m.2"
        assert one.polled() == set()
        assert not one.worker.may_ask(LINE.key, 15.0)

    def test_reading_the_bucket_again_changes_no_lease(self) -> None:
        one = at_work(LINE, until=15.0)
        one.read_again(15.0)
        assert one.me == "m.1"
        one.step(15.0)
        assert one.polled() == {LINE.key}
        assert one.worker.may_ask(LINE.key, 15.0)

    def test_reading_the_bucket_again_prolongs_no_lease_of_others(self) -> None:
        one = OneWorker()
        one.member("o.1", 0.0)
        one.steps(*every(0.0, 8.0))
        one.read_again(8.0)
        assert one.steps(9.0, 10.0) == []
        assert records(one.steps(11.0)) == {"worker.o.1": "ended"}


class TestLease:
    def test_a_lease_begins_when_the_value_that_came_back_was_sent(self) -> None:
        one = OneWorker(LINE)
        one.step(0.0)
        one.hears = False
        puts = [one.decided(at)[0] for at in (1.0, 2.0, 3.0)]
        one.hears = True
        for put, until in ((puts[1], 11.0), (puts[0], 11.0), (puts[2], 12.0)):
            one.write(put.key, put.value, 5.0)
            assert one.worker.lease_until == until

    @pytest.mark.parametrize("is_deleted", [False, True])
    def test_a_worker_recorded_as_ended_or_deleted_joins_again_under_another_id(self, is_deleted):
        one = at_work(LINE)
        if is_deleted:
            one.write("worker.m.1", None, 12.0)
        else:
            one.member("m.1", 12.0, "ended")
        assert (one.me, one.worker.has_left, one.polled()) == ("m.2", False, set())
        assert one.worker.due == -math.inf


class TestSlots:
    def test_a_slot_is_handed_over_and_polled_no_more(self) -> None:
        one = at_work(LINE, OTHER)
        one.member("b.1", 12.0)
        puts = one.decided(12.1)
        (slot,) = (put for put in puts if put.key != one.worker.key)
        (moved,) = (entry for entry in (LINE, OTHER) if entry.slot.key == slot.key)
        assert records([slot]) == {moved.slot.key: "b.1"}
        assert one.polled() == {LINE.key, OTHER.key} - {moved.key}
        # The write may still succeed when its heir has gone, and all was read again: only a second
        # write of the same key shows that it did not.
        one.member("b.1", 12.2, "ended")
        one.read_again(12.2)
        (again,) = (put for put in one.decided(14.2) if put.key != one.worker.key)
        assert (again.last, records([again])) == (slot.last, {slot.key: "m.1"})
        assert one.polled() == {LINE.key, OTHER.key} - {moved.key}
        one.write(again.key, again.value, 14.3)
        one.step(14.3)
        assert one.polled() == {LINE.key, OTHER.key}

    def test_a_write_is_repeated_after_a_fifth_of_a_lease_or_a_change(self) -> None:
        one = beside_ended()
        (beat,) = one.decided(0.0)
        one.write(beat.key, beat.value, 0.0)

        def asked(at: float) -> bool:
            """True if it writes the slot, which does not arrive."""
            return LINE.slot.key in {put.key for put in one.decided(at)}

        assert [asked(at) for at in (0.1, 0.2, 2.0)] == [True, False, False]
        assert asked(2.1)
        one.hold(LINE, "b.1", 2.2)
        assert asked(2.3)

    def test_after_a_write_without_effect_the_bucket_is_read_again(self) -> None:
        one = beside_ended()
        (beat,) = one.decided(0.0)
        one.write(beat.key, beat.value, 0.0)
        reads_again = []
        for at in (0.1, 2.0, 2.2):
            one.worker.add_change(Change(beat.key, beat.value, one.revision + int(at) + 1), at)
            one.decided(at)
            reads_again.append(one.last.must_read_again)
        assert reads_again == [False, False, True]


class TestAcknowledgements:
    def test_a_connection_is_polled_once_all_other_workers_have_seen_its_holder(self) -> None:
        one = OneWorker(LINE)
        one.member("b.1", 0.0, revision=0)
        one.hold(LINE, "m.1", by="m.1")
        one.step(0.0)
        assert one.polled() == set()
        touched = one.worker.view.touched_at(LINE)
        one.member("b.1", 0.5, revision=touched - 1)
        one.step(0.5)
        assert one.polled() == set()
        one.member("b.1", 0.6, revision=touched)
        one.step(0.6)
        assert one.polled() == {LINE.key}

    def test_a_vanished_worker_is_waited_for_as_long_as_its_lease(self) -> None:
        one = OneWorker(LINE)
        one.member("b.1", 0.0)
        one.step(0.0)
        one.write("worker.b.1", None, 1.0)
        one.hold(LINE, "m.1", 1.0, by="m.1")
        for at in every(1.0, 11.4, 0.1):
            one.step(at)
            assert one.polled() == set(), at
        one.step(11.5)
        assert one.polled() == {LINE.key}


class TestEndedWorkers:
    """They stay for `fleet status` for a minute."""

    @pytest.mark.parametrize("is_needed", [False, True])
    def test_ended_workers_are_deleted_after_a_minute_unless_they_have_a_slot(self, is_needed):
        one = OneWorker(*[NORTH] * is_needed)
        one.member("z.1", 0.0, "ended")
        one.hold(NORTH, "z.1")
        assert one.steps(*every(0.0, 59.0)) == []
        puts = one.steps(60.0, 61.0, 62.0)
        assert [(put.key, put.value) for put in puts] == [("worker.z.1", None)] * (not is_needed)


class TestBucketThatLies:
    """Values that any program with the rights of a worker may have written."""

    @pytest.mark.parametrize("beat", [-1, 0, 1, 12, 10**30])
    def test_a_value_of_its_own_key_that_it_did_not_write_extends_no_lease(self, beat: int) -> None:
        one = at_work(LINE)
        assert one.worker.lease_until == 21.0
        record = Member(one.me, "here", ("",), 60.0, beat, 10**30)
        one.write(record.bucket_key, record.encode(), 20.5)
        assert one.worker.lease_until == 21.0
        assert not one.worker.may_ask(LINE.key, 20.5)

    def test_a_worker_with_a_false_revision_counts_for_itself_only(self) -> None:
        one = OneWorker(LINE)
        one.member("b.1", revision=10**30)
        one.member("c.1", revision=0)
        one.hold(LINE, "m.1", by="m.1")
        one.step(0.0)
        assert one.polled() == set()

    def test_the_last_of_two_claims_to_a_slot_counts_once_all_have_seen_it(self) -> None:
        one = at_work(LINE)
        one.member("b.1", 12.0)
        for holder in ("b.1", "m.1", "b.1"):
            one.hold(LINE, holder, 12.1)
        one.step(12.1)
        assert one.polled() == set()
        one.hold(LINE, "m.1", 12.2)  # taken from a worker that is still there
        one.step(12.2)
        assert one.polled() == set()
        one.member("b.1", 12.3)
        one.step(12.3)
        assert one.polled() == {LINE.key}


class TestBlindness:
    def reads_again(self, one: OneWorker, at: float) -> bool:
        one.decided(at)
        return one.last.must_read_again

    def test_a_worker_that_does_not_receive_its_own_values_reads_the_bucket_again(self) -> None:
        one = OneWorker()
        assert [self.reads_again(one, at) for at in (4.9, 5.1)] == [False, True]
        one.member(one.me, 5.1)
        assert [self.reads_again(one, at) for at in (10.0, 10.2)] == [False, True]

    def test_the_bucket_is_read_again_after_a_while(self) -> None:
        one = OneWorker()
        for at in range(1, 700):
            one.step(float(at))
            assert one.last.must_read_again == (at >= 60 * LEASE)
