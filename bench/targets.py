"""
What we want to reach: ratios of two rates, and whether they are met.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from cells import (
    BLOCKING,
    BULK,
    C_CLIENT,
    C_SERVER,
    FREE,
    ONE_PROCESSOR,
    OUR_SERVER,
    SERVER,
    TO_C,
    TO_OURS,
    Key,
)


class Target(NamedTuple):
    """The best of `ours` is to be so many times as fast as `theirs`."""

    ours: tuple[Key, ...]
    theirs: Key
    least: float


class Outcome(NamedTuple):
    """A target and what was measured; None if one of the two was not."""

    target: Target
    best: Key | None
    ratio: float | None

    @property
    def is_met(self) -> bool:
        return self.ratio is not None and self.ratio >= self.target.least


def blocking(variant: str, theirs: str, least: float) -> Target:
    return Target((Key(BLOCKING, variant, "TcpContext"),), Key(BLOCKING, variant, theirs), least)


def bulk(variant: str, theirs: str, least: float) -> Target:
    names = ("TcpContext.execute_many", "AsyncClient.execute_many", "AsyncClient, gather")
    ours = tuple(Key(BULK, variant, name) for name in names)
    return Target(ours, Key(BULK, variant, theirs), least)


def server(load: str, theirs: str, least: float) -> Target:
    return Target((Key(SERVER, load, OUR_SERVER),), Key(SERVER, load, theirs), least)


TARGETS = [
    blocking(FREE, C_CLIENT, 0.95),
    blocking(FREE, "pymodbus", 1.3),
    blocking(ONE_PROCESSOR, C_CLIENT, 0.95),
    blocking(ONE_PROCESSOR, "pymodbus", 1.3),
    bulk(TO_OURS, C_CLIENT, 8),
    bulk(TO_C, C_CLIENT, 6),
    bulk(TO_OURS, "pymodbus, async", 8),
    server("100 x 1", C_SERVER, 0.75),
    server("100 x 1", "pymodbus", 3),
    server("8 x 16", C_SERVER, 2),
    server("8 x 16", "pymodbus", 10),
    Target((Key(SERVER, "1000 x 1", OUR_SERVER),), Key(SERVER, "100 x 1", OUR_SERVER), 0.8),
]


def outcome(target: Target, rate: Callable[[Key], float | None]) -> Outcome:
    rates = {key: value for key in target.ours if (value := rate(key)) is not None}
    base = rate(target.theirs)
    if not rates or not base:
        return Outcome(target, None, None)
    best = max(rates, key=rates.__getitem__)
    return Outcome(target, best, rates[best] / base)
