"""
Devices one of whose polls was dropped: their next one is refused after a single loss.
"""

from __future__ import annotations

import pytest

from libmodbus_py.fleet import Reading
from libmodbus_py.services.fleet.outputs import pump as module
from libmodbus_py.services.fleet.outputs.pump import Refusals
from libmodbus_py.services.fleet.readings import Buffer


def poll(device: str, time: float = 1.0) -> list[Reading]:
    return [Reading(time, device, name, 1, "", "good") for name in ("a", "b")]


def test_a_device_that_was_dropped_is_refused_at_once_behind_an_accepted_poll() -> None:
    made = Refusals(Buffer())
    made.note_open()
    made.note_accepted(poll("other"))
    assert not made.is_refused(poll("meter"))
    made.note_dropped("meter")
    assert made.is_refused(poll("meter", 2.0))
    assert not made.is_refused(poll("other", 2.0))


def test_on_another_connection_nothing_was_accepted_yet() -> None:
    made = Refusals(Buffer())
    made.note_dropped("meter")
    made.note_accepted(poll("other"))
    made.note_open()
    assert not made.is_refused(poll("meter", 2.0))
    made.note_accepted([])
    assert not made.is_refused(poll("meter", 2.0))
    made.note_accepted(poll("other", 3.0))
    assert made.is_refused(poll("meter", 2.0))


def test_a_device_that_is_accepted_is_as_good_as_others() -> None:
    made = Refusals(Buffer())
    made.note_dropped("meter")
    made.note_accepted(poll("meter", 2.0))
    assert not made.is_refused(poll("meter", 3.0))


def test_another_poll_that_was_accepted_is_enough() -> None:
    made = Refusals(Buffer())
    made.note_dropped("meter")
    made.suspect(poll("meter", 2.0))
    made.note_other(is_accepted=False)
    assert not made.is_refused(poll("meter", 2.0))
    made.note_other(is_accepted=True)
    assert made.is_refused(poll("meter", 2.0))


def test_what_is_accepted_ends_a_suspicion() -> None:
    made = Refusals(Buffer())
    for _ in range(2):
        made.suspect(poll("meter"))
        made.note_other(is_accepted=True)
        assert not made.is_refused(poll("meter"))
    made.note_accepted(poll("meter"))
    for is_refused in (False, False, True):
        made.suspect(poll("meter"))
        made.note_other(is_accepted=True)
        assert made.is_refused(poll("meter")) is is_refused


def test_several_polls_are_doubtful_if_one_is_of_such_a_device() -> None:
    made = Refusals(Buffer())
    both = poll("meter") + poll("other")
    assert not made.is_doubtful(both)
    made.note_dropped("meter")
    assert made.is_doubtful(both)
    assert made.is_doubtful(poll("other") + poll("meter"))
    assert made.is_doubtful(poll("meter") + poll("meter", 2.0))
    assert not made.is_doubtful(poll("meter"))
    assert not made.is_doubtful(poll("other") + poll("third"))
    # Of several polls nobody knows which was refused.
    made.note_accepted(poll("third"))
    assert not made.is_refused(both)


def test_devices_without_end_take_a_bounded_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MOST_KNOWN", 2)
    made = Refusals(Buffer())
    made.note_accepted(poll("other"))
    for device in ("a", "b", "c"):
        made.note_dropped(device)
    assert [made.is_refused(poll(device)) for device in "abc"] == [False, False, True]
