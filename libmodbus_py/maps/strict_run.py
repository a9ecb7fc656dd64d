"""
A run of a plan that ends with the first failure, and names what was refused.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

from ..protocol.errors import ModbusError
from .block_answers import BlockAnswer, Portion
from .plan_run import Enough, PlanRun, Steps

__all__ = ["StrictRun"]


class StrictRun(PlanRun):
    """
    A run of a plan in which all requests are sent until one fails: nothing is left out.

    If a request is refused, it is halved until the first item is known that the device refuses;
    the refusal of that item is the answer then, with its name in `names`. Arguments and attributes
    are those of `PlanRun`.
    """

    def _run(self) -> Steps:
        self._failure: tuple[int, ModbusError] | None = None
        outcomes = yield list(self._plan.requests)
        for at, (reading, outcome) in enumerate(zip(self._readings, outcomes, strict=True)):
            if not isinstance(outcome, ModbusError | list):
                break  # not sent any more
            asked = Portion(reading, 0, len(reading.block.pieces))
            is_refused = self._note(asked, outcome)
            if isinstance(outcome, ModbusError):
                self._failure = at, outcome
                if is_refused:
                    yield from self._name(asked)
                break

    @property
    def answers(self) -> list[Any]:
        """The answers to the requests of the plan; from the first failure on, only that."""
        if self._failure is None:
            return super().answers
        at, error = self._failure
        return [*(reading.answer for reading in self._readings[:at]), error]

    def _name(self, asked: Portion) -> Steps:
        try:
            found = yield from self._first_refused(asked)
        except Enough:
            return
        error = None if found is None else asked.reading.errors.get(found.first)
        if found is not None and error is not None and self._failure is not None:
            self._add(found, error)
            error.names = asked.reading.block.pieces[found.first].names
            self._failure = self._failure[0], error

    def _first_refused(self, asked: Portion) -> Generator[Any, list[Any], Portion | None]:
        if asked.last - asked.first == 1:
            return asked
        for known in self._known_in(asked.reading):
            if not (yield from self._ask(known)):
                return known
        narrow = yield from self._narrowed(asked)
        one = Portion(asked.reading, narrow.at, narrow.at + 1)
        if narrow.is_direct or not (yield from self._ask(one)):
            return one
        return None

    def _known_in(self, reading: BlockAnswer) -> list[Portion]:
        """Return the first piece that was refused before, if there is one."""
        found = [at for at in range(len(reading.block.pieces)) if self._is_hole(reading, at)]
        return [Portion(reading, at, at + 1) for at in found[:1]]
