"""
Options of a gateway that hold for all of its lines.
"""

from __future__ import annotations

from collections.abc import Iterable, Sized
from dataclasses import dataclass, field

from ...protocol.checks import integer, seconds
from ...protocol.mistakes import WrongType
from .routes import units_of

__all__ = ["GatewayOptions"]


@dataclass(frozen=True)
class GatewayOptions:
    """
    Options of a gateway; the documentation of `Gateway` describes them.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
    """

    own_units: str | Iterable[int] = (255,)
    queue: int = 16
    longest_wait: float = 5.0
    writes_first: bool = False
    own: frozenset[int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        given = self.own_units
        units = [] if isinstance(given, Sized) and not len(given) else units_of("own_units", given)
        object.__setattr__(self, "own", frozenset(units))
        integer("queue", self.queue, 1, 1024)
        seconds("longest_wait", self.longest_wait)
        if not isinstance(self.writes_first, bool):
            raise WrongType("writes_first", f"must be True or False, not {self.writes_first!r}")
