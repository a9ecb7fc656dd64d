"""
A poll after which the other side ends the connection is refused, if others are accepted.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs.pump import Refusals
from libmodbus_py.services.fleet.readings import Buffer


def poll(time: float) -> list[Reading]:
    return [Reading(time, "meter", name, 1, "", "good") for name in ("a", "b")]


class Waiting:
    """Polls at these times that wait, with what is suspected of them."""

    def __init__(self, *times: float) -> None:
        self.buffer = Buffer()
        for time in times:
            self.buffer.put(poll(time))
        self.refusals = Refusals(self.buffer)

    def other(self) -> float | None:
        """Return the time of the poll that is sent before the suspected one."""
        found: Sequence[Reading] = asyncio.run(self.refusals.others())
        assert not found or list(found) == poll(found[0].time)
        return found[0].time if found else None

    def lose(self, time: float, *, other: bool | None) -> bool:
        """Suspect a poll that is lost once more, behind another one that fares so."""
        self.refusals.suspect(poll(time))
        if self.other() is not None and other is not None:
            self.refusals.note_other(is_accepted=other)
        return self.refusals.is_refused(poll(time))


def test_nothing_is_sent_before_a_poll_that_is_not_suspected() -> None:
    assert Waiting(1.0, 2.0).other() is None


def test_a_poll_is_refused_when_others_were_accepted_three_times() -> None:
    waiting = Waiting(1.0, 2.0)
    assert [waiting.lose(1.0, other=True) for _ in range(3)] == [False, False, True]


def test_a_poll_is_not_refused_while_others_are_lost_too() -> None:
    waiting = Waiting(1.0, 2.0, 3.0)
    assert not any(waiting.lose(1.0, other=False) for _ in range(9))
    assert [waiting.lose(1.0, other=True) for _ in range(3)] == [False, False, True]


def test_a_poll_alone_is_not_refused() -> None:
    waiting = Waiting(1.0)
    waiting.refusals.suspect(poll(1.0))
    assert waiting.other() is None
    assert not any(waiting.lose(1.0, other=None) for _ in range(9))


def test_once_another_is_accepted_the_suspected_one_is_next() -> None:
    waiting = Waiting(1.0, 2.0)
    waiting.refusals.suspect(poll(1.0))
    assert waiting.other() == 2.0
    waiting.refusals.note_other(is_accepted=True)
    assert waiting.other() is None
    waiting.refusals.suspect(poll(1.0))
    assert waiting.other() == 2.0


def test_if_another_is_lost_too_the_next_one_is_tried() -> None:
    waiting = Waiting(1.0, 2.0, 3.0)
    waiting.refusals.suspect(poll(1.0))
    tried = []
    for _ in range(4):
        tried.append(waiting.other())
        waiting.refusals.note_other(is_accepted=False)
    assert tried == [2.0, 3.0, 2.0, 3.0]


def test_another_suspected_poll_is_counted_for_itself() -> None:
    waiting = Waiting(1.0, 2.0, 3.0)
    for _ in range(2):
        assert not waiting.lose(1.0, other=True)
    asyncio.run(waiting.buffer.take_polls(1))
    assert [waiting.lose(2.0, other=True) for _ in range(3)] == [False, False, True]


def test_a_suspected_poll_that_does_not_wait_any_more_is_forgotten() -> None:
    waiting = Waiting(2.0, 3.0)
    waiting.refusals.suspect(poll(1.0))
    assert waiting.other() is None
    assert not waiting.refusals.is_refused(poll(1.0))
    waiting = Waiting()
    waiting.refusals.suspect(poll(1.0))
    assert waiting.other() is None


def test_nothing_is_suspected_any_more_when_all_is_clear() -> None:
    waiting = Waiting(1.0, 2.0)
    waiting.refusals.suspect(poll(1.0))
    waiting.refusals.clear()
    assert waiting.other() is None
