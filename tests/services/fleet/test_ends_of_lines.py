"""
A fleet that has ended asks nobody any more, whatever waited, rested or was in flight.
"""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.fleet import DeviceConfig
from tests.services.fleet.fleets import in_simulated_time
from tests.simulation.plants import MAP, Plant

AFTERWARDS = 10.0
"""Simulated seconds in which nobody must be asked."""


def between_requests(plant: Plant) -> list[DeviceConfig]:
    return [plant.device(1, MAP, spacing=1.0)]


def in_a_queue(plant: Plant) -> list[DeviceConfig]:
    plant.delay = 0.4
    return [plant.device(unit, interval=0.5) for unit in (1, 2, 3)]


def silent(plant: Plant) -> list[DeviceConfig]:
    plant.silent = {1}
    return [plant.device(unit, interval=0.5) for unit in (1, 2)]


@pytest.mark.parametrize("removed", [False, True])
@pytest.mark.parametrize("situation", [between_requests, in_a_queue, silent])
@pytest.mark.parametrize("seconds", [0.1, 0.9, 1.3, 2.2, 3.1])
@in_simulated_time
async def test_nobody_is_asked_after_the_end(situation: Any, seconds: float, removed: bool) -> None:
    plant = Plant()
    fleet = Fleet(situation(plant))
    async with fleet:
        await asyncio.sleep(seconds)
        if removed:
            fleet.remove(plant.device(1).connection_key)
            asked = len(plant.asked)
            await asyncio.sleep(AFTERWARDS)
            assert len(plant.asked) == asked
    asked = len(plant.asked)
    await asyncio.sleep(AFTERWARDS)
    assert len(plant.asked) == asked
    statistics = fleet.statistics
    assert statistics.polls <= asked
