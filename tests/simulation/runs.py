"""Runs of a simulated world: that of a seed, and the shortest that fails as it does."""

import inspect
import json
import random
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from .events import START, Events
from .rules import Broken
from .scenarios import SCENARIOS
from .world import FAULTS, Options, World

# Seconds between two requests of a client, on average, and how long they go on: from a rush to a
# quiet night.
PAUSES = ((0.01, 20.0), (0.1, 60.0), (1.0, 60.0), (30.0, 4 * 3600.0))

# Workers look at their clocks all the time, and others talk, so an hour of theirs takes long.
LONGEST = {"fleet": 60.0, "workers": 300.0, "busy line": 120.0, "odd hosts": 60.0}


BY_NAME = ("plant",)
"""Scenarios that are played when they are named."""


def options_of(seed: int) -> Options:
    """Return the run that a seed stands for."""
    choice = random.Random(seed)
    scenario = choice.choice([scenario for scenario in SCENARIOS if scenario not in BY_NAME])
    pause, seconds = choice.choice(PAUSES)
    return Options(
        seed,
        scenario,
        clients=choice.randint(1, 6),
        units=choice.randint(1, 12),
        faults=tuple(fault for fault in FAULTS[:-1] if choice.random() < 0.6),
        pause=pause,
        seconds=min(seconds, LONGEST.get(scenario, seconds)),
    )


class Sent(NamedTuple):
    """Bytes that were sent together."""

    at: float
    place: str
    connection: int
    is_client: bool
    data: bytes


class Exchange:
    """Keeps the last of what was sent."""

    def __init__(self, events: Events, most: int = 400) -> None:
        self._events = events
        self._sent: deque[Sent] = deque(maxlen=most)

    def tell(self, place: str, connection: int, is_client: bool, data: bytes) -> None:
        """See `Network.tap`."""
        self._sent.append(Sent(self._events.now - START, place, connection, is_client, data))

    def raw(self) -> Iterator[str]:
        """Return a line for each piece: the time, the place, who sent it, and its bytes."""
        for message in self._sent:
            arrow = "->" if message.is_client else "<-"
            where = f"{message.place} {message.connection}" if message.connection else message.place
            yield f"{message.at:10.4f}  {where:24} {arrow} {message.data.hex(' ')}"


@dataclass
class Failure:
    """A run that fails."""

    options: Options
    error: AssertionError
    exchange: Exchange

    @property
    def rule(self) -> str:
        """The rule that does not hold, or the kind of the error."""
        return self.error.rule if isinstance(self.error, Broken) else type(self.error).__name__


def seed_options() -> list[Options]:
    """Return the runs that failed once, oldest first."""
    seeds = json.loads(Path(__file__).with_name("seeds.json").read_text())
    return [Options(**{**seed["run"], "faults": tuple(seed["run"]["faults"])}) for seed in seeds]


def play(options: Options) -> World:
    """Run a scenario to its end."""
    world = World(options)
    _run(world)
    return world


def run_or_failure(options: Options, lines: list[str] | None = None) -> Failure | World:
    """Run a scenario; return how it failed, or the world at its end. `lines` get what was last."""
    world = World(options)
    exchange = Exchange(world.events)
    world.network.tap = exchange.tell
    try:
        _run(world)
    except AssertionError as error:
        return Failure(options, error, exchange)
    finally:
        if lines is not None:
            lines += exchange.raw()
    return world


def shortest_options(failure: Failure, seconds: float = 10.0) -> Failure:
    """Make a run smaller as long as it fails in the same way; so many seconds long at most."""
    until = time.monotonic() + seconds
    is_smaller = True
    while is_smaller and time.monotonic() < until:
        is_smaller = False
        for options in _smaller(failure.options):
            outcome = run_or_failure(options)
            if isinstance(outcome, Failure) and outcome.rule == failure.rule:
                failure, is_smaller = outcome, True
                break
    return failure


def _smaller(options: Options) -> Iterator[Options]:
    for fault in options.faults:
        yield replace(options, faults=tuple(entry for entry in options.faults if entry != fault))
    for name in ("clients", "units"):
        number = getattr(options, name)
        if number > 1:
            yield replace(options, **{name: number // 2})
    if options.seconds > 1:
        yield replace(options, seconds=options.seconds / 2)


def _run(world: World) -> None:
    world.events.looks.append(world.checker.look)
    tap = world.network.tap
    tell = world.wire.tell
    world.network.tap = tell if tap is None else partial(_both, tap, tell)
    scenario = SCENARIOS[world.options.scenario]
    state = random.getstate()
    random.seed(world.options.seed)  # of the pauses before connecting again
    try:
        if inspect.iscoroutinefunction(scenario):
            world.network.run(partial(scenario, world))
        else:
            with world.network.installed():
                scenario(world)
    finally:
        random.setstate(state)
    world.checker.look()


def _both(one: Callable[..., object], other: Callable[..., object], *args: Any) -> None:
    one(*args)
    other(*args)
