"""Rules of the package broken on purpose, to see that the simulated world finds each of them."""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

from libmodbus_py.client.asyncio_driver import AsyncioDriver
from libmodbus_py.client.history import Pair
from libmodbus_py.client.ids import Ids
from libmodbus_py.client.line import Line
from libmodbus_py.protocol.errors import InvalidResponse
from libmodbus_py.protocol.framing import Frame
from libmodbus_py.services.gateway.silent_units import SilentUnits, UnitState
from libmodbus_py.services.line import FairQueue
from libmodbus_py.services.workers.decisions import _Deciding
from libmodbus_py.services.workers.worker import Worker

from .world import Options


@dataclass(frozen=True)
class Break:
    """One rule that is taken out."""

    rule: str
    scenarios: tuple[str, ...]
    broken: Callable[[], AbstractContextManager[object]]
    faults: tuple[str, ...] = ()

    def options(self, base: Options) -> Options:
        """Return the run of a seed, with one of these scenarios."""
        scenario = self.scenarios[base.seed % len(self.scenarios)]
        faults = self.faults or base.faults
        pause = min(base.pause, 0.1)
        return replace(base, scenario=scenario, faults=faults, pause=pause, seconds=20.0)


@contextlib.contextmanager
def _answers_in_any_order() -> Iterator[None]:
    """Take each answer for that to the oldest request, whatever its id says."""
    before = Ids.take

    def take(self: Any, data: bytes, now: float) -> Any:
        renumbered = b""
        for frame in self._framer.scan(data):
            if isinstance(frame, Frame):
                number = next(iter(self.pending), frame.transaction)
                renumbered += number.to_bytes(2, "big") + self._framer.encode(frame)[2:]
        return before(self, renumbered, now)

    with patch.object(Ids, "take", take):
        yield


@contextlib.contextmanager
def _any_unit_answers() -> Iterator[None]:
    before = Line._judge

    def judge(self: Any, frame: Any, now: float) -> None:
        call = self._call
        is_answer = isinstance(frame, Frame) and call is not None
        before(self, frame._replace(unit=call.unit) if is_answer else frame, now)

    with patch.object(Line, "_judge", judge):
        yield


@contextlib.contextmanager
def _only_one_queue() -> Iterator[None]:
    """Serve hosts in the order of their requests."""
    put = FairQueue.put

    def put_together(self: Any, each: Any) -> bool:
        each.host = each.client = "all"
        return put(self, each)

    with patch.object(FairQueue, "put", put_together):
        yield


def _end_at_once(line: Any, unit: int, function: int, call: Any, now: float) -> None:
    """Take a frame of another function for the end of the wait, and doubt nothing."""
    if call is not None:
        call.reply = InvalidResponse(f"function {function} was answered")
        line._end(call)


def _nothing(*_: Any, **__: Any) -> None:
    return None


BREAKS: tuple[Break, ...] = (
    Break("an answer has the id of its request", ("tcp", "gateway"), _answers_in_any_order),
    Break(
        "a line is silent before a unit is asked again",
        ("line", "rtu+tcp", "blocking"),
        lambda: patch.object(Pair, "doubt", _nothing),
    ),
    Break(
        "an answer is of the unit that was asked",
        ("line", "gateway"),
        _any_unit_answers,
        ("late", "cancel"),
    ),
    Break(
        "a frame of another function is not an answer",
        ("line",),
        lambda: patch.object(Line, "_note_other", _end_at_once),
        ("late", "other_function"),
    ),
    Break(
        "who may ask looks at the clock",
        ("workers",),
        lambda: patch.object(Worker, "may_ask", lambda self, key, now: key in self.active),
    ),
    Break(
        "who waits for the end of another worker's lease looks at it then",
        ("workers",),
        lambda: patch.object(_Deciding, "has_passed", lambda self, at: self.now >= at),
    ),
    Break(
        "a paused unit gets no request",
        ("silent unit",),
        lambda: patch.object(SilentUnits, "state", lambda *_: UnitState.GOOD),
    ),
    Break("hosts take turns", ("many clients",), _only_one_queue),
    Break(
        "what a caller withdrew is not sent",
        ("tcp", "line", "rtu+tcp"),
        lambda: patch.object(AsyncioDriver, "withdraw", _nothing),
        ("cancel", "late"),
    ),
)
