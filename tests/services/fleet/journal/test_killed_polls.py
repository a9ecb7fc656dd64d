"""
A poll with a journal that is killed (kill -9) at any moment: what the journal has arrives, and one
batch at most arrives twice for each kill. `fuzz.journal_trial` does so more often, with MQTT.
"""

from __future__ import annotations

import asyncio
import random
import signal
import sqlite3
from contextlib import suppress
from pathlib import Path

from fuzz.journal_trial import Found, KilledPolls, devices, until
from libmodbus_py.services.fleet.outputs.pump import MOST_OF_JOURNAL

KILLS = 3


def confirmed(polls: KilledPolls) -> int:
    with suppress(sqlite3.Error, ValueError):  # the journal is being created
        return min(polls.places().values())
    return 0


def test_a_poll_that_is_killed_loses_nothing_that_was_journalled(tmp_path: Path) -> None:
    async def go() -> KilledPolls:
        async with devices(5) as urls:
            polls = KilledPolls(tmp_path, urls, interval=0.05)
            for _ in range(KILLS):
                with polls.running():
                    size = polls.size + random.randint(1, 50_000)
                    await until(lambda size=size: polls.size > size)  # type: ignore[misc]
            last = polls.in_journal()[-1]
            with polls.running() as process:
                await until(lambda: confirmed(polls) > last and len(polls.in_journal()) > 100)
                process.send_signal(signal.SIGTERM)
                assert await asyncio.to_thread(process.wait) == 0
        return polls

    polls = asyncio.run(go())
    arrived, journal = polls.in_file(), polls.in_journal()
    found = Found(journal, confirmed(polls), arrived)
    assert found.lost == 0
    assert found.repeated <= KILLS * (MOST_OF_JOURNAL + 10)
    assert confirmed(polls) == journal[-1]
