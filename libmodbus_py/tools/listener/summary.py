"""
Counts of the traffic on a line.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from ...protocol.errors import ExceptionResponse
from .transaction import Transaction

__all__ = ["Summary"]


@dataclass
class AnswerTimes:
    """
    The response times of a unit, in seconds.

    Attributes:
        count: the number of responses.
        shortest, mean, longest: 0.0 before the first response.
    """

    count: int = 0
    shortest: float = 0.0
    longest: float = 0.0
    total: float = 0.0

    @property
    def mean(self) -> float:
        return self.total / self.count if self.count else 0.0

    def note(self, seconds: float) -> None:
        """Count one more."""
        self.shortest = min(self.shortest, seconds) if self.count else seconds
        self.longest = max(self.longest, seconds)
        self.total += seconds
        self.count += 1


@dataclass
class UnitSummary:
    """
    The traffic of one unit.

    Attributes:
        transactions: the number of transactions.
        functions: ``{function code: number of requests}``.
        errors: ``{error: number}``; the error is a kind of transaction or "exception N".
        repeats: the number of requests that were repetitions.
        times: the response times.
    """

    transactions: int = 0
    functions: Counter[int] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)
    repeats: int = 0
    times: AnswerTimes = field(default_factory=AnswerTimes)

    def note(self, transaction: Transaction) -> None:
        """Count a transaction of this unit; the request of a late response is counted already."""
        if transaction.kind not in ("late", "unasked"):
            self.transactions += 1
            self.repeats += transaction.repeats > 0
            self.functions[transaction.function or 0] += 1
        if transaction.kind == "exception" and isinstance(transaction.error, ExceptionResponse):
            self.errors[f"exception {transaction.error.code}"] += 1
        elif transaction.kind not in ("answered", "broadcast"):
            self.errors[transaction.kind] += 1
        if transaction.kind in ("answered", "exception") and transaction.duration is not None:
            self.times.note(transaction.duration)


@dataclass
class Summary:
    """
    The traffic so far.

    Attributes:
        transactions: the number of transactions of all units.
        damaged: the number of runs of bytes that are not a frame and belong to no request.
        units: ``{unit 0..255: summary of the unit}``.
    """

    transactions: int = 0
    damaged: int = 0
    units: dict[int, UnitSummary] = field(default_factory=dict)

    def note(self, transaction: Transaction) -> None:
        """Count one more."""
        if transaction.unit is None:
            self.damaged += 1
            return
        unit = self.units.setdefault(transaction.unit, UnitSummary())
        before = unit.transactions
        unit.note(transaction)
        self.transactions += unit.transactions - before

    def as_dict(self) -> dict[str, Any]:
        """Return the counts as a dict that JSON can represent; times are in seconds."""
        return {
            "transactions": self.transactions,
            "damaged": self.damaged,
            "units": {
                str(number): {
                    "transactions": unit.transactions,
                    "functions": {str(code): count for code, count in unit.functions.items()},
                    "errors": dict(unit.errors),
                    "repeats": unit.repeats,
                    "shortest": unit.times.shortest,
                    "mean": unit.times.mean,
                    "longest": unit.times.longest,
                }
                for number, unit in sorted(self.units.items())
            },
        }

    def __str__(self) -> str:
        lines = [f"{self.transactions} transactions, {self.damaged} runs of damaged bytes"]
        for number, unit in sorted(self.units.items()):
            functions = ", ".join(
                f"{code} ({unit.functions[code]})" for code in sorted(unit.functions)
            )
            errors = ", ".join(f"{count} {name}" for name, count in unit.errors.most_common())
            times = unit.times
            took = "{:.1f} / {:.1f} / {:.1f} ms (shortest, mean, longest)".format(
                *(each * 1000 for each in (times.shortest, times.mean, times.longest))
            )
            lines += [
                f"unit {number}: {unit.transactions} transactions, {unit.repeats} repeats",
                f"  functions     {functions or '-'}",
                f"  answer times  {took if times.count else '-'}",
                f"  errors        {errors or 'none'}",
            ]
        return "\n".join(lines)
