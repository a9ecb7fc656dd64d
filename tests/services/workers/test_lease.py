"""
How a worker counts its lease, when it must read all again, and what a fleet file may say of it.
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from libmodbus_py.services.workers.lease import Lease
from libmodbus_py.services.workers.records import (
    SETTINGS,
    Connection,
    FleetSettings,
    Member,
    encode_holder,
)
from libmodbus_py.services.workers.view import BucketView, Entry
from libmodbus_py.services.workers.worker import Worker

LEASE = 10.0


def member(beat: int, state: Any = "here", id: str = "a.1") -> Member:
    return Member(id, state, ("",), LEASE, beat)


class TestLease:
    def test_it_begins_when_its_value_was_sent_and_is_used_in_part(self) -> None:
        lease = Lease("a.1")
        assert lease.next_beat(100.0, LEASE, False) == 1
        assert lease.until == -math.inf
        lease.came_back(member(1))
        assert lease.until == 109.0
        assert lease.joined

    def test_who_has_not_joined_has_none_although_it_was_written(self) -> None:
        lease = Lease("a.1")
        lease.next_beat(100.0, LEASE, False)
        lease.is_confirmed(1, 7)
        assert (lease.until, lease.revision) == (-math.inf, 7)

    def test_a_confirmation_extends_it_and_an_older_one_takes_nothing_back(self) -> None:
        lease = Lease("a.1")
        lease.next_beat(100.0, LEASE, False)
        lease.came_back(member(1))
        assert lease.next_beat(105.0, LEASE, False) == 2
        assert lease.next_beat(108.0, LEASE, False) == 3
        lease.is_confirmed(3, 9)
        assert (lease.until, lease.revision) == (117.0, 9)
        lease.is_confirmed(2, 8)
        assert (lease.until, lease.revision) == (117.0, 9)

    def test_a_value_that_was_never_sent_extends_nothing(self) -> None:
        lease = Lease("a.1")
        lease.next_beat(100.0, LEASE, False)
        lease.came_back(member(5))
        assert lease.until == -math.inf

    @pytest.mark.parametrize(
        ("is_granted", "hurry", "pause"),
        [(True, False, 1.0), (False, False, 2.0), (True, True, 0.1), (False, True, 0.1)],
    )
    def test_it_is_asked_for_again_in_time(
        self, is_granted: bool, hurry: bool, pause: float
    ) -> None:
        lease = Lease("a.1")
        lease.next_beat(100.0, LEASE, False)
        if is_granted:
            lease.came_back(member(1))
        assert lease.next_beat(100.0 + pause - 0.001, LEASE, hurry) is None
        assert lease.next_beat(100.0 + pause, LEASE, hurry) == 2


class TestBlindness:
    def _worker(self) -> Worker:
        worker = Worker(lambda: "a.1", {""})
        worker.begins()
        worker.saw(Entry(SETTINGS, FleetSettings(LEASE).encode(), 1), 0.0)
        return worker

    def test_who_is_reading_is_not_blind(self) -> None:
        worker = self._worker()
        assert not worker.is_blind(1000.0)
        worker.is_synced(0.0)
        assert worker.is_blind(1000.0)
        worker.begins()
        assert not worker.is_blind(1000.0)

    def test_who_knows_of_no_fleet_is_not_blind(self) -> None:
        worker = Worker(lambda: "a.1", {""})
        worker.begins()
        worker.is_synced(0.0)
        assert not worker.is_blind(1000.0)

    def test_who_does_not_see_its_own_values_is_blind(self) -> None:
        worker = self._worker()
        worker.is_synced(0.0)
        assert not worker.is_blind(2.9)
        assert worker.is_blind(3.1)
        worker.saw(Entry("worker.a.1", member(1).encode(), 2), 3.0)
        assert not worker.is_blind(5.9)
        assert worker.is_blind(6.1)

    def test_all_is_read_again_after_a_while(self) -> None:
        worker = self._worker()
        worker.is_synced(0.0)
        for at in range(1, 700):
            worker.saw(Entry("worker.a.1", member(at).encode(), 1 + at), float(at))
            assert worker.is_blind(float(at)) == (at >= 60 * LEASE)


class TestSilence:
    def test_others_are_silent_only_while_this_worker_sees_its_own_values(self) -> None:
        """A value that was not seen for a while may have been written, and lost on its way."""
        worker = Worker(lambda: "a.1", {""})
        worker.begins()
        worker.saw(Entry(SETTINGS, FleetSettings(LEASE).encode(), 1), 0.0)
        worker.is_synced(0.0)

        def renewed(at: float, revision: int) -> None:
            (beat,) = (put for put in worker.step(at) if put.beat)
            worker.saw(Entry(beat.key, beat.value, revision), at)

        renewed(0.0, 2)
        worker.saw(Entry("worker.b.2", member(1, id="b.2").encode(), 3), 1.0)
        renewed(2.0, 4)
        renewed(30.0, 5)
        assert [put.key for put in worker.step(30.1)] == []
        for at in range(31, 41):
            renewed(float(at), at)
        assert [put.key for put in worker.step(40.6) if not put.beat] == ["worker.b.2"]


class TestView:
    def test_a_worker_that_is_deleted_and_never_ended_has_vanished(self) -> None:
        view = BucketView()
        view.add(Entry("worker.a.1", member(1).encode(), 1), 5.0)
        view.add(Entry("worker.b.1", member(1, "ended", "b.1").encode(), 2), 5.0)
        assert sorted(view.members) == ["a.1", "b.1"]
        view.add(Entry("worker.a.1", None, 3), 6.0)
        view.add(Entry("worker.b.1", None, 4), 7.0)
        assert view.members == {}
        assert list(view.vanished.values()) == [6.0]

    def test_a_slot_that_its_holder_did_not_give_up_must_be_acknowledged(self) -> None:
        view = BucketView()
        line = Connection("", "tcp:192.0.2.1:502", 1.0, '{"devices": []}')
        view.add(Entry(line.bucket_key, line.encode(), 1), 0.0)
        view.add(Entry("worker.a.1", member(1).encode(), 2), 0.0)
        view.add(Entry("worker.b.1", member(1, id="b.1").encode(), 3), 0.0)

        def touched(revision: int, holder: str, by: str) -> int:
            view.add(Entry(line.slot.key, encode_holder(holder, by), revision), 0.0)
            return view.touched_at(line)

        assert touched(4, "a.1", "a.1") == 4  # Its holder before is unknown.
        assert touched(5, "b.1", "a.1") == 1  # Handed over.
        assert touched(6, "a.1", "a.1") == 6  # Taken from a worker that is still there.
        view.add(Entry("worker.a.1", member(2, "ended").encode(), 7), 0.0)
        assert touched(8, "b.1", "b.1") == 1  # Taken from a worker that has ended.
        assert view.last_touched == 6

    def test_what_is_known_is_not_taken_again(self) -> None:
        view = BucketView()
        assert view.add(Entry("worker.a.1", member(2).encode(), 2), 5.0)
        assert not view.add(Entry("worker.a.1", member(1).encode(), 1), 6.0)
        assert not view.add(Entry("worker.a.1", member(2).encode(), 2), 6.0)
        assert view.members["a.1"].beat == 2
        assert view.seen["worker.a.1"] == (2, 5.0)
        assert view.revision == 2
