"""
The targets: ratios of two rates, and whether they are met.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

from bench.cells import (
    ASYNC_BULK,
    BLOCKING,
    BULK,
    C_CLIENT,
    C_SERVER,
    CLIENT,
    CLIENT_BULK,
    CONTEXT,
    FREE,
    ONE_PROCESSOR,
    OUR_SERVER,
    SERVER,
    TO_C,
    TO_OURS,
    WRITE_HOOK_SERVER,
    Key,
)


class Target(NamedTuple):
    """`ours` must be so many times as fast as `theirs`; or is only intended to be."""

    ours: Key
    theirs: Key
    least: float
    is_aim: bool = False


class Outcome(NamedTuple):
    """A target and the measured ratio; None if one of the two was not measured."""

    target: Target
    ratio: float | None

    @property
    def is_met(self) -> bool:
        return self.ratio is not None and self.ratio >= self.target.least


def blocking(variant: str, ours: str, theirs: str, least: float) -> Target:
    keys = Key(BLOCKING, variant, ours), Key(BLOCKING, variant, theirs)
    return Target(*keys, least, is_aim=theirs == C_CLIENT)


def bulk(variant: str, ours: str, theirs: str, least: float) -> Target:
    return Target(Key(BULK, variant, ours), Key(BULK, variant, theirs), least)


def server(load: str, theirs: str, least: float, ours: str = OUR_SERVER) -> Target:
    return Target(Key(SERVER, load, ours), Key(SERVER, load, theirs), least)


TARGETS = [
    *(
        blocking(variant, ours, theirs, least)
        for variant, (ours, theirs, least) in product(
            (FREE, ONE_PROCESSOR),
            ((CONTEXT, C_CLIENT, 0.95), (CONTEXT, "pylibmodbus", 1), (CLIENT, "pymodbus", 1)),
        )
    ),
    *(
        bulk(variant, ours, theirs, least)
        for ours, (variant, theirs, least) in product(
            (CLIENT_BULK, ASYNC_BULK),
            ((TO_OURS, C_CLIENT, 8), (TO_C, C_CLIENT, 6), (TO_OURS, "pymodbus, async", 8)),
        )
    ),
    server("100 x 1", C_SERVER, 0.75),
    server("100 x 1", "pymodbus", 3),
    server("8 x 16", C_SERVER, 2),
    server("8 x 16", "pymodbus", 10),
    server("100 x 1", OUR_SERVER, 0.9, ours=WRITE_HOOK_SERVER),
    Target(Key(SERVER, "1000 x 1", OUR_SERVER), Key(SERVER, "100 x 1", OUR_SERVER), 0.8),
]


def outcome(target: Target, rate: Callable[[Key], float | None]) -> Outcome:
    ours, theirs = rate(target.ours), rate(target.theirs)
    return Outcome(target, ours / theirs if ours and theirs else None)
