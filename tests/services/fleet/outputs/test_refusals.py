"""
A poll after which the other side ends the connection is refused, if others are accepted.
"""

from __future__ import annotations

import asyncio

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.pump import Refusals
from libmodbus_py.services.fleet.readings import Buffer


def poll(time: float, device: str = "meter") -> list[Reading]:
    return [Reading(time, device, name, 1, "", "good") for name in ("a", "b")]


class Waiting:
    """Polls at these times that wait, with what is suspected of them."""

    def __init__(self, *times: float) -> None:
        self.buffer = Buffer()
        for time in times:
            self.buffer.put(poll(time))
        self.refusals = Refusals(self.buffer)

    def other(self) -> float | None:
        """Return the time of the poll that is sent before the suspected one."""
        found = asyncio.run(self.refusals.others())
        assert not found or list(found) == poll(found[0].time)
        return found[0].time if found else None

    def lose(self, time: float, *, other: bool | None) -> bool:
        """Open a connection that ends at a poll, behind another one that fares so."""
        self.refusals.note_open()
        if self.other() is not None and other is not None:
            self.refusals.note_other(is_accepted=other)
        return self.refusals.is_refused(poll(time))


@pytest.mark.parametrize(
    ("times", "other", "refused"),
    [
        ((1.0, 2.0), True, [False, False, False, True]),  # the first time it is not suspected
        ((1.0, 2.0, 3.0), False, [False] * 9),
        ((1.0,), None, [False] * 9),
    ],
    ids=["others are accepted", "others are lost too", "it is alone"],
)
def test_a_poll_is_refused_when_others_were_accepted_three_times(
    times: tuple[float, ...], other: bool | None, refused: list[bool]
) -> None:
    waiting = Waiting(*times)
    assert [waiting.lose(1.0, other=other) for _ in refused] == refused


def test_another_poll_is_sent_before_a_suspected_one_once_on_each_connection() -> None:
    waiting = Waiting(1.0, 2.0, 3.0)
    assert waiting.other() is None
    waiting.lose(1.0, other=None)
    tried = []
    for _ in range(4):  # while others are lost too, another one is tried
        tried.append(waiting.other())
        waiting.refusals.note_other(is_accepted=False)
    assert tried == [2.0, 3.0, 2.0, 3.0]
    waiting.refusals.note_other(is_accepted=True)
    assert waiting.other() is None
    waiting.refusals.note_open()
    assert waiting.other() == 2.0
    waiting.refusals.note_accepted(poll(1.0))
    assert waiting.other() is None


def test_a_suspicion_is_of_one_poll() -> None:
    waiting = Waiting(1.0, 2.0, 3.0)
    for _ in range(3):
        assert not waiting.lose(1.0, other=True)
    asyncio.run(waiting.buffer.take_polls(1))
    assert [waiting.lose(2.0, other=True) for _ in range(4)] == [False, False, False, True]
    waiting.lose(2.0, other=True)
    asyncio.run(waiting.buffer.take_polls(1))
    waiting.refusals.note_open()
    assert waiting.other() is None  # it fell out of the buffer


def after_a_drop() -> Refusals:
    """Return refusals, on a new connection, after a poll of the meter was dropped."""
    waiting = Waiting(1.0, 2.0)
    while not waiting.lose(1.0, other=True):
        pass
    waiting.refusals.note_open()
    return waiting.refusals


def test_a_device_that_was_dropped_is_refused_once_something_else_was_accepted() -> None:
    made = after_a_drop()
    assert not made.is_refused(poll(2.0))  # the other side may be away
    made.note_accepted([])
    assert not made.is_refused(poll(2.0))
    made.note_accepted(poll(3.0, "other"))
    assert not made.is_refused(poll(2.0, "other"))
    assert made.is_refused(poll(2.0))
    made.note_accepted(poll(3.0))  # and then it is as good as others
    assert not made.is_refused(poll(4.0))


def test_several_polls_are_doubtful_if_one_is_of_such_a_device() -> None:
    both = poll(2.0) + poll(2.0, "other")
    assert not Refusals(Buffer()).is_doubtful(both)
    made = after_a_drop()
    assert made.is_doubtful(both)
    assert made.is_doubtful(poll(1.0) + poll(2.0))
    assert not made.is_doubtful(poll(1.0))
    assert not made.is_doubtful(poll(2.0, "other") + poll(2.0, "third"))
    made.note_accepted(poll(3.0, "third"))
    assert not made.is_refused(both)  # nobody knows which of them
