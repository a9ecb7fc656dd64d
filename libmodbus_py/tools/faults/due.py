"""
The faults of one server: which is due for a request, and answers that it changes.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Mapping
from dataclasses import replace

from ...device.access import Touched, touched_by
from ...protocol.checks import integer
from ...protocol.framing import Frame, TcpFramer
from ...server.service import Intercepted
from .delivery import Delivery, fragments
from .fault import Fault

__all__ = ["Faults"]


NO_ALIASES: dict[int, int] = {}


class _Counted:
    """A fault, and its count of requests."""

    def __init__(self, fault: Fault) -> None:
        self.fault = fault
        self._every = fault.every or 1
        self._count = 0
        self._random = random.Random(fault.seed)

    def is_due(self) -> bool:
        if self.fault.probability is not None:
            return self._random.random() < self.fault.probability
        self._count += 1
        return self._count % self._every == 0

    def happening(self) -> Fault:
        """The fault as it happens this time: with its random bytes."""
        fault = self.fault
        if fault.kind != "garbage" or fault.length is None:
            return fault
        return replace(fault, data=self._random.randbytes(fault.length), length=None, seed=None)


class Faults:
    """
    The faults of one server. See `Interceptor`.

    Args:
        faults: ``{unit 0..255: faults}``; None is every unit.
        before: the previous faults of the same server: equal ones go on counting.
        aliases: further units, and the unit whose faults they have if they have none of their own.

    Raises:
        TypeError, ValueError: a unit or a fault is wrong.
    """

    def __init__(
        self,
        faults: Mapping[int | None, Iterable[Fault]],
        before: Faults | None = None,
        aliases: Mapping[int, int] = NO_ALIASES,
    ) -> None:
        self._by_unit: dict[int | None, list[_Counted]] = {}
        for unit, given_faults in faults.items():
            key = None if unit is None else integer("faults: unit", unit, 0, 255)
            known = [] if before is None else list(before._by_unit.get(key, ()))
            self._by_unit[key] = [_counted(_checked(fault), known) for fault in given_faults]
        for alias, unit in aliases.items():
            if unit in self._by_unit:
                self._by_unit.setdefault(alias, self._by_unit[unit])

    def __bool__(self) -> bool:
        return any(self._by_unit.values())

    def concerns(self, unit: int) -> bool:
        """Return True if the answers of a unit have faults."""
        return bool(self._by_unit.get(unit) or self._by_unit.get(None))

    def intercept(self, session: Intercepted) -> FaultyAnswers:
        return FaultyAnswers(session)

    def due(self, request: Frame, *, has_transaction: bool) -> Fault | None:
        """
        Count a request that is going to be answered.

        Args:
            request: the request as it was received.
            has_transaction: True if frames of its line have transactions.

        Returns:
            The fault that happens to the request, or None.
        """
        touched: Touched | None = None
        first: _Counted | None = None
        for key in (request.unit, None):
            for each in self._by_unit.get(key, ()):
                fault = each.fault
                if fault.function not in (None, request.pdu[0]):
                    continue
                if fault.kind == "wrong_transaction" and not has_transaction:
                    continue
                if not fault.is_everywhere:
                    touched = touched or touched_by(request.pdu)
                    if not fault.hits(touched):
                        continue
                if each.is_due() and first is None:
                    first = each
        return None if first is None else first.happening()


def _checked(fault: object) -> Fault:
    if not isinstance(fault, Fault):
        raise TypeError(f"faults must be {{unit or None: [Fault, ...]}}, not {fault!r}")
    return fault


def _counted(fault: Fault, known: list[_Counted]) -> _Counted:
    """Return the known counter of an equal fault, each once, or a new one."""
    for at, each in enumerate(known):
        if each.fault == fault:
            return known.pop(at)
    return _Counted(fault)


class FaultyAnswers:
    """The answers of one session: late, wrong, in fragments or not at all. See `Interception`."""

    def __init__(self, session: Intercepted) -> None:
        self._session = session
        self._delivery = Delivery(session.channel, session.trace, session.write)
        self._has_transaction = isinstance(session.framer, TcpFramer)

    @property
    def is_waiting(self) -> bool:
        return self._delivery.is_waiting

    @property
    def is_over(self) -> bool:
        return self._delivery.is_over

    def answer(self, request: Frame) -> None:
        """Execute a request, and deliver its answer as the fault that is due makes it."""
        session, fault = self._session, None
        faults = session.interceptor
        if isinstance(faults, Faults) and session.is_answered(request):
            fault = faults.due(request, has_transaction=self._has_transaction)
        answer = session.answer(request, 0 if fault is None else fault.code or 0)
        if answer is not None:
            session.statistics.refused += answer.pdu[0] >> 7
            self._delivery.send(fragments(fault, answer, session.framer))

    def close(self) -> None:
        self._delivery.close()
