"""
The rules of the simulated world hold for recorded and for a few fixed seeds, the same seed gives
the same exchange, and what is broken on purpose is found. ``./run simulate`` does more of it.
"""

from dataclasses import replace

import pytest

from .__main__ import find
from .broken import BREAKS, Break
from .runs import Failure, options_of, play, run_or_failure, seed_options, shortest_options
from .scenarios import SCENARIOS
from .world import Options

# Whatever rule is broken, one of so many seeds shows it.
SEEDS = 100

# A whole plant takes minutes; it is run on its own.
QUICK = [scenario for scenario in SCENARIOS if scenario != "plant"]


@pytest.mark.parametrize("scenario", QUICK)
@pytest.mark.parametrize("seed", range(3))
def test_every_scenario_follows_the_rules(scenario: str, seed: int) -> None:
    play(replace(options_of(seed), scenario=scenario, seconds=20.0))


@pytest.mark.parametrize("options", seed_options(), ids=lambda run: f"{run.scenario}-{run.seed}")
def test_recorded_failures_do_not_fail_again(options: Options) -> None:
    play(options)


@pytest.mark.parametrize("scenario", ["line", "gateway", "fleet"])
def test_the_same_seed_gives_the_same_exchange(scenario: str) -> None:
    options = replace(options_of(5), scenario=scenario, seconds=10.0)
    first, second = play_and_listen(options), play_and_listen(options)
    assert first == second
    assert first


def play_and_listen(options: Options) -> list[str]:
    """Return what was said last."""
    lines: list[str] = []
    world = run_or_failure(options, lines)
    assert not isinstance(world, Failure), world.error
    return lines


@pytest.mark.parametrize("broken", BREAKS, ids=lambda broken: broken.rule)
def test_each_defect_made_on_purpose_is_found(broken: Break) -> None:
    failure = find(broken, seeds=SEEDS)
    assert failure is not None
    with broken.broken():
        smaller = shortest_options(failure, 2.0)
    assert smaller.rule == failure.rule
    assert list(smaller.exchange.raw()) or smaller.options.scenario == "workers"
