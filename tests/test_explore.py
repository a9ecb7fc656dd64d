"""The explorer of connections finds nothing, and finds each rule that is broken on purpose."""

import logging
import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from typing import Any
from unittest.mock import patch

import pytest

from fuzz.explore import explore, run
from libmodbus_py.client import line
from libmodbus_py.client.history import History, Pair
from libmodbus_py.client.line import Line
from libmodbus_py.client.queue import Queue

PARTS = 6  # the worlds of four requests with one that is unusual are walked in so many parts


@pytest.fixture(autouse=True)
def log_of_other_tests() -> Iterator[None]:
    """Undo what `explore` does to the log of the process."""
    yield
    logging.disable(logging.NOTSET)


def always(value: Any) -> property:
    """Return an attribute that is never set."""
    return property(lambda self: value, lambda self, other: None)


reset_of_line = Line.reset


def forget_history(self: Any, now: float) -> list[Any]:
    calls = reset_of_line(self, now)
    self._history = History()
    return calls


def forget_call(self: Any, call: Any, now: float) -> bool:
    was_in_flight = self._call is call
    self._call = None if was_in_flight else self._call
    return was_in_flight


next_of_queue = Queue.next


def next_beside_answered(self: Any, now: float, in_flight: int, unsettled: int) -> Any:
    return next_of_queue(self, now, in_flight, 0)


Breaking = Callable[[], AbstractContextManager[Any]]

# What else line.py holds, tests/client/test_line_states.py and test_line_history.py need: with one
# fault, the other rules see it in the times of answers.
ON_LINES: dict[str, Breaking] = {
    "DOUBT waits for silence": lambda: patch.object(Pair, "quiet_at", always(0.0)),
    "a failure leads to DOUBT": lambda: patch.object(Pair, "doubt", lambda *_: None),
    "a caller who is gone leads to DOUBT": lambda: patch.object(Line, "withdraw", forget_call),
    "DOUBT outlives a connection": lambda: patch.object(Line, "reset", forget_history),
    "what is known of a line outlives a client": lambda: patch.object(
        line, "history_of", lambda endpoint: History()
    ),
    "answers are checked again and again": lambda: patch.object(
        Pair, "interval", always(math.inf), create=True
    ),
    "an answer that came too soon is held": lambda: patch.object(
        Pair, "is_too_fast", lambda *_: False
    ),
    "the beginning of an answer breaks the silence": lambda: patch.object(
        Line, "_note_beginnings", lambda *_: None
    ),
    "doubtful answers are held": lambda: patch.object(
        Line, "_hold", lambda self, call, pdu, now: self._believe(call, pdu, now, now)
    ),
    "HOLD lasts": lambda: patch.object(Pair, "hold_of", lambda *_: 0.0),
    "silence after a single answer ends DOUBT": lambda: patch.object(
        Pair, "is_answered", always(False)
    ),
}

WITH_IDS: dict[str, Breaking] = {
    "a write is alone": lambda: patch.object(Queue, "write", always(None), create=True),
    "a write waits for the outcome of what was answered": lambda: patch.object(
        Queue, "next", next_beside_answered
    ),
}


@pytest.mark.parametrize("has_ids", [False, True])
def test_no_sequence_of_events_gives_an_unnamed_wrong_result(has_ids: bool) -> None:
    assert explore(has_ids, 4, 1, (1, PARTS)).errors == {}


# Worlds in which a unit works through late requests of several functions.
BACKLOGS = [
    "A:good B:good A:good B:good WAW:late_17 AB:slow",
    "A:good B:good AW:late_29 WAW:slow",
    "A:good B:good F:late_17 AW:echo",
]


@pytest.mark.parametrize("world", BACKLOGS)
def test_a_late_answer_to_one_function_causes_doubt_of_other_functions(world: str) -> None:
    steps = [word.replace("_", " ").split(":") for word in world.split()]
    assert run(False, True, 0, [(move, act) for move, act in steps]).errors == set()


# Worlds in which one fault meets another, and the most values that are not right.
MEETINGS = [
    # A refusal, the first answer of its length, that comes too soon: else all are shifted.
    ("pause_A:twice_+2 strays_A:busy A:good B:good A:good B:good", True, 1, 1),
    # A read that comes back is no answer, and shows no time of one.
    ("A:late_17 B:echo A:good B:good", True, 0, 0),
    # A late answer behind a repeated request: its unit is no faster than before.
    ("A:good pause_A:late_17 A:good B:good A:good B:good pause_A:twice_+1 B:good", False, 1, 0),
]


@pytest.mark.parametrize(("world", "changes", "retries", "most"), MEETINGS)
def test_two_faults_together_cause_no_lasting_shift(
    world: str, changes: bool, retries: int, most: int
) -> None:
    steps = [word.replace("_", " ").split(":") for word in world.split()]
    result = run(False, changes, retries, [(move, act) for move, act in steps])
    assert result.errors <= {"stale"}
    assert result.wrong_values == most


def test_a_shift_without_an_unusual_time_ends_when_an_answer_is_checked() -> None:
    usual = [("AB"[at % 2], "good") for at in range(5)]
    steps = [("pause A", "twice +6"), ("B", "good"), ("A", "slower"), *usual]
    assert run(False, True, 1, steps).errors == {"wrong", "stale"}


@pytest.mark.parametrize("rule", [*ON_LINES, *WITH_IDS])
def test_each_broken_rule_is_found(rule: str) -> None:
    broken = ON_LINES.get(rule) or WITH_IDS[rule]
    with broken():
        assert any(explore(rule in WITH_IDS, 4, 1, (part, PARTS)).errors for part in range(PARTS))
