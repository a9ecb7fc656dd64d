"""When devices are polled: phases, skipping, how late polls begin, and that each counts once."""

import asyncio
from dataclasses import fields
from typing import Any

import pytest

from libmodbus_py.services.fleet.fleet import first_time
from libmodbus_py.services.fleet.statistics import LATENESS_BOUNDS, FleetStatistics
from tests.services.fleet.fleets import in_simulated_time
from tests.simulation.plants import MAP, ONE, Plant


def test_phases_are_spread_evenly() -> None:
    """Ten thousand devices each 5 s: in no tenth of a second begin twice as many as should."""
    times = [first_time(f"device {number}", 5.0, 100.0, 1e9) for number in range(10_000)]
    assert all(100.0 <= time_ < 105.0 for time_ in times)
    counts = [0] * 50
    for time_ in times:
        counts[int((time_ - 100.0) * 10)] += 1
    assert 100 < min(counts) <= max(counts) < 300


# Simulated seconds: of a device's polls by default, and between two looks at what is so.
INTERVAL, LOOK = 1.0, 0.001

COUNTED = {"up", "down", "polls", "failures", "refusals", "skipped", "vetoes", "readings"}

CASES: dict[str, tuple[dict[str, Any], dict[str, int]]] = {
    "it answers": ({}, {"up": 1, "polls": 4, "readings": 4}),
    "two requests each": ({"points": MAP}, {"up": 1, "polls": 4, "readings": 8}),
    "it refuses": ({"refusing": {1}}, {"up": 1, "polls": 4, "refusals": 4, "readings": 1}),
    "it may not be asked": ({"may_ask": lambda _: False}, {"vetoes": 4}),
    "its answers take too long": (
        {"delay": 0.45},
        {"up": 1, "polls": 1, "skipped": 2, "readings": 1},
    ),
}


def counted(statistics: FleetStatistics) -> dict[str, int]:
    counts = {field.name: getattr(statistics, field.name) for field in fields(statistics)}
    return {name: value for name, value in counts.items() if name in COUNTED and value}


@pytest.mark.parametrize("name", CASES)
@in_simulated_time
async def test_each_poll_has_exactly_one_outcome(name: str) -> None:
    options, counts = CASES[name]
    plant = Plant()
    plant.refusing = options.get("refusing", set())
    plant.delay = options.get("delay", plant.delay)
    interval = 0.3
    device = plant.device(1, options.get("points", ONE), interval=interval)
    async with plant.polls(device, may_ask=options.get("may_ask")):
        # The first poll is at a time of its own within the interval.
        while not (plant.asked or plant.fleet.statistics.vetoes):
            await asyncio.sleep(LOOK)
        await asyncio.sleep(3.4 * interval)
        statistics = plant.fleet.statistics
        assert statistics.devices == 1
        assert counted(statistics) == counts
        begun = statistics.vetoes or sum(address == 0 for _, _, address in plant.asked)
        assert sum(statistics.lateness) == begun


def test_lateness_is_counted_by_its_bounds() -> None:
    statistics = FleetStatistics()
    assert statistics.within(LATENESS_BOUNDS[0]) == 0.0
    for bound in LATENESS_BOUNDS:
        statistics.note_start(bound)
        statistics.note_start(bound + 1e-9)
    assert statistics.lateness == [1, *[2] * (len(LATENESS_BOUNDS) - 1), 1]
    assert statistics.late_seconds == pytest.approx(2 * sum(LATENESS_BOUNDS))
    total = 2 * len(LATENESS_BOUNDS)
    for at, bound in enumerate(LATENESS_BOUNDS):
        assert statistics.within(bound) == (2 * at + 1) / total
    assert statistics.take_worst() == LATENESS_BOUNDS[-1] + 1e-9
    assert statistics.take_worst() == 0.0
    statistics.note_start(0.5)
    statistics.note_start(0.25)
    assert statistics.worst == 0.5
