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
