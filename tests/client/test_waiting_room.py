"""
Who may ask next on a connection, with times from a list.
"""

from __future__ import annotations

from typing import NamedTuple

from libmodbus_py.client.waiting_room import FairByHost


class Asked(NamedTuple):
    host: str
    client: str
    number: int
    unit: int = 1


def order(queue: FairByHost[Asked], held: tuple[int, ...] = ()) -> str:
    found = []
    while (each := queue.pick(lambda each: each.unit not in held)) is not None:
        found.append(f"{each.client}{each.number}")
    return " ".join(found)


def filled(*asked: Asked, most_of_client: int = 9, most: int = 99) -> FairByHost[Asked]:
    queue: FairByHost[Asked] = FairByHost(most_of_client, most)
    assert all(queue.put(each) for each in asked)
    return queue


def test_clients_take_queue_and_each_is_answered_in_its_order() -> None:
    eager = [Asked("h", "a", number) for number in range(4)]
    queue = filled(*eager, Asked("h", "b", 0), Asked("h", "c", 0), Asked("h", "b", 1))
    assert order(queue) == "a0 b0 c0 a1 b1 a2 a3"
    assert len(queue) == 0


def test_a_host_with_many_clients_has_no_more_queue_than_another() -> None:
    many = [Asked("h", name, 0) for name in "abcd"]
    assert order(filled(*many, Asked("i", "x", 0), Asked("i", "x", 1))) == "a0 x0 b0 x1 c0 d0"


def test_who_has_had_a_turn_comes_last_when_he_asks_again() -> None:
    queue = filled(Asked("h", "a", 0), Asked("h", "b", 0), Asked("h", "a", 1))
    first = queue.pick()
    assert first is not None
    assert first.client == "a"
    assert queue.put(Asked("h", "a", 2))
    assert order(queue) == "b0 a1 a2"


def test_one_client_fills_its_own_queue_only() -> None:
    queue = filled(Asked("h", "a", 0), Asked("h", "a", 1), most_of_client=2, most=3)
    assert not queue.put(Asked("h", "a", 2))
    assert queue.put(Asked("h", "b", 0))
    assert not queue.put(Asked("h", "c", 0))  # as many as may wait in all
    assert order(queue) == "a0 b0 a1"


def test_what_is_held_waits_and_nobody_behind_it() -> None:
    queue = filled(Asked("h", "a", 0, 5), Asked("h", "a", 1), Asked("h", "b", 0, 5))
    assert order(queue, held=(5,)) == "a1"
    assert order(queue) == "b0 a0" or len(queue) == 0


def test_what_is_removed_is_not_given() -> None:
    queue = filled(*(asked := [Asked("h", "a", 0), Asked("h", "a", 1), Asked("i", "b", 0)]))
    queue.remove(asked[1])
    queue.remove(asked[2])
    assert not queue.has(asked[2])
    assert list(queue) == asked[:1]
    assert order(queue) == "a0"
