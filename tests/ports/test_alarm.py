"""
The one timer of clients, gateways and fleets: it rings by the earliest time that it was set for.
"""

from __future__ import annotations

import asyncio
import math

from libmodbus_py.ports.waiting_async import Alarm
from tests.simulation.network import Network


def rung(*times: float, until: float, is_cancelled: bool = False) -> tuple[list[float], float]:
    """Return when an alarm that was set for these times rang, and when it would ring again."""
    found: list[float] = []

    async def main() -> float:
        loop = asyncio.get_running_loop()
        began = loop.time()
        alarm = Alarm(lambda: found.append(loop.time() - began))
        for each in times:
            alarm.set(began + each, loop)
        if is_cancelled:
            alarm.cancel()
        await asyncio.sleep(until)
        at = alarm.at
        alarm.cancel()
        return at - began

    return found, Network(1).run(main)


def test_the_earliest_time_counts_in_any_order() -> None:
    assert rung(5, 2, 3, until=10) == ([2], math.inf)
    assert rung(2, 5, until=10) == ([2], math.inf)


def test_before_its_time_it_is_silent_and_tells_when() -> None:
    assert rung(5, 3, until=1) == ([], 3)


def test_once_cancelled_it_never_rings() -> None:
    assert rung(2, until=10, is_cancelled=True) == ([], math.inf)


def test_after_it_rang_it_can_be_set_for_a_later_time() -> None:
    async def main() -> list[float]:
        loop, found = asyncio.get_running_loop(), []
        began = loop.time()

        def ring() -> None:
            found.append(loop.time() - began)
            if len(found) < 3:
                alarm.set(loop.time() + len(found), loop)

        alarm = Alarm(ring)
        alarm.set(began + 1, loop)
        await asyncio.sleep(10)
        return found

    assert Network(1).run(main) == [1, 2, 4]
