"""
The procedure by which a client carries out a plan, and learns which items the device refuses.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from ..maps.holes import is_refusal, reading
from ..maps.plan import Plan
from ..protocol.errors import ModbusError
from ..protocol.logs import HarmlessLogger
from .procedures import Several

if TYPE_CHECKING:
    from .handle import Handle
    from .procedures import Steps

__all__ = ["plan_answers"]


def plan_answers(
    client: Handle[Any], plan: Plan, max_in_flight: int, return_exceptions: bool
) -> Steps[list[Any]]:
    """
    Return the answers to the requests of a plan, for `Plan.results`.

    Raises:
        ModbusError: the first failure; only without `return_exceptions`.
    """
    holes = client.holes
    answers: list[Any] = []
    if not holes:
        answers = yield Several(plan.requests, max_in_flight, return_exceptions, True)
    if holes or any(map(is_refusal, answers)):
        now, connects = client.now(), client.statistics.connects
        steps = reading(
            plan.blocks,
            holes,
            now,
            connects,
            is_strict=not return_exceptions,
            tell=partial(HarmlessLogger(__name__).info, "%s: cannot be read: %s", client.device),
        )
        try:
            requests = next(steps)
            # Another thread, or task, may have learnt something meanwhile.
            outcomes = answers if requests == list(plan.requests) else None
            while True:
                if not outcomes:
                    outcomes = yield Several(requests, max_in_flight, return_exceptions, True)
                requests, outcomes = steps.send(outcomes), None
        except StopIteration as done:
            answers = done.value
    if not return_exceptions:
        for each in answers:
            if isinstance(each, ModbusError):
                raise each
    return answers
