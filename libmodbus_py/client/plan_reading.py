"""
The procedure by which a client carries out a plan, and learns which cells the device refuses.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import TYPE_CHECKING, Any, Protocol

from ..maps.plan import Plan
from ..maps.plan_run import PlanRun, says_something
from ..maps.strict_run import StrictRun
from ..protocol.errors import ModbusError
from ..protocol.logs import HarmlessLogger
from .procedures import Several

if TYPE_CHECKING:
    from .procedures import Steps

__all__ = ["Asking", "plan_answers"]


class Asking(Protocol):
    """The part of a client that is used here."""

    @property
    def url(self) -> str: ...

    @property
    def unit(self) -> int: ...

    @property
    def device(self) -> Hashable: ...

    @property
    def connection(self) -> tuple[Hashable, int]: ...

    def now(self) -> float: ...


def plan_answers(
    client: Asking, plan: Plan, max_in_flight: int, return_exceptions: bool
) -> Steps[list[Any]]:
    """
    Return the answers to the requests of a plan, for `Plan.results`.

    Raises:
        ModbusError: the first failure; only without `return_exceptions`.
    """
    known = plan.holes.get(client.device)
    first: list[Any] = []
    if not known:
        first = yield Several(plan.requests, max_in_flight, return_exceptions, True)
        if not any(isinstance(each, ModbusError) for each in first):
            return first
        if not any(map(says_something, first)):
            return _raised(first, return_exceptions)
        known = plan.holes.made(client.device, f"{client.url}, unit {client.unit}")
    kind = PlanRun if return_exceptions else StrictRun
    run = kind(plan, known, client.now(), *client.connection)
    if first and run.requests == list(plan.requests):
        run.take(first)
    while run.requests:
        outcomes = yield Several(run.requests, max_in_flight, return_exceptions, True)
        run.take(outcomes)
    for each in run.news:
        HarmlessLogger(__name__).info("%s: cannot be read: %s", known.device, each)
    return _raised(run.answers, return_exceptions)


def _raised(answers: list[Any], return_exceptions: bool) -> list[Any]:
    if not return_exceptions:
        for each in answers:
            if isinstance(each, ModbusError):
                raise each
    return answers
