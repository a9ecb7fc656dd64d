"""
What a worker knows of the bucket, change by change: times and revisions from a list.
"""

from typing import Any

from libmodbus_py.services.engine.buckets import Change
from libmodbus_py.services.workers.records import (
    BucketView,
    Connection,
    FleetSettings,
    Member,
)
from tests.services.workers.simulated import encode_holder
from tests.support.cases import each_case

LINE = Connection("", "tcp:192.0.2.1:502", 1.0, '{"devices": []}')
NORTH = Connection("north", LINE.key, 1.0, '{"devices": []}')
OTHER = Connection("", "tcp:192.0.2.2:502", 1.0, '{"devices": []}')


def member(id: str = "a.1", state: Any = "here", beat: int = 1, lease: float = 10.0) -> bytes:
    return Member(id, state, ("",), lease, beat).encode()


def view_of(*entries: tuple[str, bytes | None, int], at: float = 0.0) -> BucketView:
    view = BucketView()
    for entry in entries:
        view.add(Change(*entry), at)
    return view


class TestChanges:
    def test_a_worker_that_is_deleted_and_never_ended_has_vanished_until_it_comes_again(
        self,
    ) -> None:
        view = view_of(("worker.a.1", member(), 1), ("worker.b.1", member("b.1", "ended"), 2))
        view.add(Change("worker.a.1", None, 3), 3.0)
        view.add(Change("worker.b.1", None, 4), 3.0)
        assert (view.members, view.vanished) == ({}, {"a.1": 3.0})
        view.add(Change("worker.a.1", member(), 5), 4.0)
        assert view.vanished == {}


class TestValuesThatCannotBeRead:
    @each_case(
        ("key", "value"),
        [
            ("settings", b"{}"),
            ("worker.a.1", b"[]"),
            ("slot._.7", b""),
            (LINE.bucket_key, b"{"),
            (LINE.bucket_key, OTHER.encode()),
        ],
    )
    def test_the_previous_value_is_forgotten_and_the_reason_known(
        self, key: str, value: bytes
    ) -> None:
        good = {
            "settings": FleetSettings().encode(),
            "worker.a.1": member(),
            "slot._.7": encode_holder("a.1", "a.1"),
            LINE.bucket_key: LINE.encode(),
        }[key]
        view = view_of((key, good, 1))
        view.add(Change(key, value, 2), 1.0)
        assert list(view.unreadable) == [key]
        assert view.unreadable[key].startswith(f"{key}: ")
        if key != "settings":  # those stay as they were
            assert (view.members, view.holders, list(view.connections)) == ({}, {}, [])
        view.add(Change(key, good, 3), 2.0)
        assert view.unreadable == {}
        view.add(Change(key, value, 4), 3.0)
        view.add(Change(key, None, 5), 4.0)
        assert view.unreadable == {}


class TestConnections:
    @each_case("is_reversed", [False, True])
    def test_of_a_connection_in_two_zones_the_newer_one_counts(self, is_reversed: bool) -> None:
        first, second = (NORTH, LINE) if is_reversed else (LINE, NORTH)
        view = view_of(
            (first.bucket_key, first.encode(), 1), (second.bucket_key, second.encode(), 2)
        )
        assert [each.zone for each in view.connections] == [second.zone]
        assert {each.zone for each in view.all_connections} == {"", "north"}
        assert set(view.used_slots) == {LINE.slot, NORTH.slot}
        view.add(Change(second.bucket_key, None, 3), 0.0)
        assert [each.zone for each in view.connections] == [first.zone]
        assert view.used_slots == {first.slot}

    def test_each_change_must_be_acknowledged_and_that_of_a_worker_must_not(self) -> None:
        view = view_of((LINE.bucket_key, LINE.encode(), 3), (OTHER.bucket_key, OTHER.encode(), 4))
        assert (view.touched_at(LINE), view.touched_at(OTHER)) == (3, 4)
        assert view.last_touched == 4
        view.add(Change("worker.a.1", member(), 5), 0.0)
        view.add(Change("settings", FleetSettings().encode(), 6), 0.0)
        assert view.last_touched == 4
        view.add(Change(LINE.bucket_key, None, 7), 0.0)
        assert view.touched_at(LINE) == view.last_touched == 7
        # A zone to which it moves is another key of the same connection.
        view.add(Change(NORTH.bucket_key, NORTH.encode(), 8), 0.0)
        assert view.touched_at(LINE) == view.touched_at(NORTH) == 8

    def test_a_slot_that_its_holder_did_not_give_up_must_be_acknowledged(self) -> None:
        view = view_of(
            (LINE.bucket_key, LINE.encode(), 1),
            ("worker.a.1", member(), 2),
            ("worker.b.1", member("b.1"), 3),
        )

        def touched(revision: int, holder: str, by: str) -> int:
            view.add(Change(LINE.slot.key, encode_holder(holder, by), revision), 0.0)
            return view.touched_at(LINE)

        assert touched(4, "a.1", "a.1") == 4  # Its holder before is unknown.
        assert touched(5, "b.1", "a.1") == 1  # Handed over.
        assert touched(6, "a.1", "a.1") == 6  # Taken from a worker that is still there.
        view.add(Change("worker.a.1", member(state="ended", beat=2), 7), 0.0)
        assert touched(8, "b.1", "b.1") == 1  # Taken from a worker that has ended.
        assert view.last_touched == 6


class TestReadAgain:
    """A whole bucket that replaces what was known: the times of its changes are kept."""

    def test_what_is_gone_was_deleted_just_now_at_the_latest(self) -> None:
        before = view_of((LINE.bucket_key, LINE.encode(), 1), ("worker.a.1", member(), 2), at=5.0)
        view = view_of(("worker.a.1", member(), 2), ("worker.b.1", member("b.1"), 7), at=9.0)
        view.follow(before, 9.0)
        assert view.last_change(LINE.bucket_key) == (0, 9.0)
        assert view.touched_at(LINE) == view.last_touched == 7

    def test_a_worker_that_is_gone_without_having_ended_has_vanished(self) -> None:
        before = view_of(
            ("worker.a.1", member(), 1),
            ("worker.b.1", member("b.1", "ended"), 2),
            ("worker.c.1", member("c.1"), 3),
            ("worker.d.1", member("d.1"), 4),
        )
        before.add(Change("worker.d.1", None, 5), 2.0)
        view = view_of(("worker.c.1", member("c.1"), 3), ("settings", FleetSettings().encode(), 6))
        view.follow(before, 9.0)
        assert view.vanished == {"a.1": 9.0, "d.1": 2.0}

    def test_what_was_given_up_is_no_more_uncertain_than_before(self) -> None:
        """A snapshot has the last change of a slot only, not who gave it up."""
        line = (LINE.bucket_key, LINE.encode(), 1)
        taken = (LINE.slot.key, encode_holder("b.1", "a.1"), 3)
        given = view_of(line, (LINE.slot.key, encode_holder("a.1", "a.1"), 2), taken)
        assert given.touched_at(LINE) == 1
        again = view_of(line, taken)
        assert again.touched_at(LINE) == 3
        again.follow(given, 9.0)
        assert again.touched_at(LINE) == 1

        uncertain = view_of(line, taken)
        again = view_of(line, taken)
        again.follow(uncertain, 9.0)
        assert again.touched_at(LINE) == 3

        newer = view_of(line, (LINE.slot.key, encode_holder("a.1", "a.1"), 4))
        newer.follow(given, 9.0)
        assert newer.touched_at(LINE) == 4

    def test_equal_revisions_of_a_bucket_that_lost_changes_mean_nothing(self) -> None:
        taken = (LINE.slot.key, encode_holder("b.1", "a.1"), 3)
        given = (LINE.slot.key, encode_holder("a.1", "a.1"), 2)
        before = view_of((LINE.bucket_key, LINE.encode(), 1), given, taken)
        before.add(Change("worker.a.1", member(), 9), 1.0)
        view = view_of((LINE.bucket_key, LINE.encode(), 1), taken, at=8.0)
        view.follow(before, 9.0)
        assert view.touched_at(LINE) == 3
        assert view.last_change(LINE.slot.key) == (3, 8.0)
