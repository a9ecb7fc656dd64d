"""
A fleet as a page shows it: outputs, values with their age, devices that are down, since when and
why, and devices that come and go while somebody looks.
"""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from typing import Any

from libmodbus_py import Fleet
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet.shown_fleet import PageOutput, ShownFleet
from libmodbus_py.services.fleet.statistics import JournalStatistics
from tests.services.fleet.fleets import Peer, good, in_simulated_time, meter, until
from tests.support.outputs import Picky


def shown_fleet(
    *devices: DeviceConfig, outputs: Sequence[Any] = ()
) -> tuple[Fleet, ShownFleet, PageOutput]:
    page = PageOutput()
    fleet = Fleet(devices, outputs=[page, *outputs])
    return fleet, ShownFleet("plant", fleet, page), page


def rows(shown: ShownFleet) -> dict[str, Any]:
    """Return the rows by their names."""
    return {" ".join(row.cells()[0][:2]).strip(): row for row in shown.rows()}


def cells(shown: ShownFleet) -> dict[str, list[Any]]:
    return {name: row.cells() for name, row in rows(shown).items()}


def problems(shown: ShownFleet) -> list[str]:
    return [name for name, row in rows(shown).items() if row.is_problem]


def value(shown: ShownFleet, name: str) -> list[str]:
    found: list[str] = cells(shown).get(name, [0, 0, ["", ""]])[2]
    return found


PAIR = [(1, "a"), (2, "b")]


@in_simulated_time
async def test_values_and_devices_also_of_one_that_is_down() -> None:
    silent: set[int] = set()

    async def answer(request: bytes) -> bytes | None:
        return None if request[6] in silent else await good(request)

    async with Peer(answer) as peer:
        devices = [meter(name, peer.url, unit=unit, timeout=0.1) for unit, name in PAIR]
        fleet, shown, _ = shown_fleet(*devices)
        assert shown.rows() == []
        async with fleet:
            assert shown.status() == ("0 of 2 devices answer", False)
            await until(lambda: value(shown, "b power") == ["7", "W"])
            await until(lambda: shown.status() == ("all 2 devices answer", False))
            place = peer.url.partition("?")[0]
            assert list(rows(shown))[:2] == ["a", "a voltage"]
            assert rows(shown)["b"].words == f"b {place}"
            assert cells(shown)["b power"][1] == ["good", "", 0]
            up, told = cells(shown)["b"], fleet.devices["b"]
            assert up[0] == ["", "b", f"{place}, unit 2"]
            assert up[1:3] == [["up", "", round(told.since, 1)], ["3 points", "every 0.1 s"]]
            assert 0 < told.since <= told.answered_at
            assert up[6] == round(told.answered_at, 1)
            assert problems(shown) == []

            silent.add(2)
            await until(lambda: fleet.statistics.down == 1)
            await until(lambda: cells(shown)["b power"][1][0] == "down")
            assert shown.status() == ("1 of 2 devices down", True)
            word, reason, since = cells(shown)["b"][1]
            assert word == "down"
            assert "no " in reason
            assert not any(text in reason for text in ("function", "ModbusTimeout"))
            assert since >= up[1][2]
            assert problems(shown) == ["b"]  # and not each of its points
            assert value(shown, "b power") == ["-", "W"]

            silent.clear()
            await until(lambda: value(shown, "b power") == ["7", "W"])


@in_simulated_time
async def test_an_output_shows_what_waits_since_when_and_why() -> None:
    async with Peer() as peer:
        away = Picky("database", is_away=True)
        fleet, shown, _ = shown_fleet(meter("a", peer.url), outputs=[away])
        async with fleet:
            await until(lambda: fleet.statistics.outputs["database"].waiting > 20)
            assert next(iter(rows(shown))) == "output database"
            assert "page" not in rows(shown)
            first = cells(shown)["output database"]
            assert first[1][:2] == ["fails", "Connection refused"]
            assert int(first[2][0]) > 20
            assert first[2][1] == "waiting"
            failures = fleet.statistics.outputs["database"].failures
            await until(lambda: fleet.statistics.outputs["database"].failures > failures + 1)
            assert cells(shown)["output database"][1] == first[1]  # since the first failure
            assert first[1][2] > 0
            assert problems(shown) == ["output database"]
            assert shown.status() == ("output database fails", True)
            away.is_away = False
            await until(lambda: away.accepted)
            await until(lambda: cells(shown)["output database"][1] == ["works", "", 0])
            assert problems(shown) == []


def test_a_journal_that_fails_is_a_problem() -> None:
    fleet, shown, _ = shown_fleet()
    fleet.statistics.journal = JournalStatistics()
    fleet.statistics.journal.bytes = 12_345_678
    assert cells(shown)["journal"][1:3] == [["works", "", 0], ["12.3", "MB"]]
    assert problems(shown) == []
    fleet.statistics.journal.trouble = "No space left on device"
    assert problems(shown) == ["journal"]
    assert cells(shown)["journal"][1] == ["fails", "No space left on device", 0]
    assert shown.status() == ("journal fails", True)


@in_simulated_time
async def test_a_value_that_is_only_reported_when_it_changes_is_as_old_as_the_last_poll() -> None:
    async with Peer() as peer:
        fleet, shown, _ = shown_fleet(meter("a", peer.url, on_change=True))
        async with fleet:
            await until(lambda: value(shown, "a power")[0] == "7")
            row = rows(shown)["a power"]
            polls = fleet.statistics.polls
            await until(lambda: fleet.statistics.polls > polls + 3)
            answered = fleet.devices["a"].answered_at
            assert answered > row.reading[0]
            assert row.cells()[6] == round(answered, 1)
            series = shown.series(("a", "power"), "last values")
            assert series is not None
            assert series.samples.every is None


@in_simulated_time
async def test_devices_that_are_replaced_while_somebody_looks() -> None:
    async with Peer() as peer:
        fleet, shown, _ = shown_fleet(meter("a", peer.url), meter("b", peer.url, unit=2))
        async with fleet:
            await until(lambda: value(shown, "b power")[0] == "7")
            row = rows(shown)["b power"]
            assert row.samples.every == 0.1
            fleet.replace([meter("b", peer.url, unit=2), meter("c", peer.url, unit=3)])
            await until(lambda: "c power" in rows(shown))
            assert "a" not in rows(shown)
            assert "a power" not in rows(shown)
            assert rows(shown)["b power"] is row  # with all its samples
            assert value(shown, "b power")[0] == "7"


@in_simulated_time
async def test_a_look_from_another_thread_does_not_disturb_a_fleet_that_changes() -> None:
    is_over: list[bool] = []
    async with Peer() as peer:
        fleet, shown, output = shown_fleet()

        def look() -> None:
            while not is_over:
                cells(shown), shown.status(), shown.figures()

        async with fleet:
            looking = asyncio.create_task(asyncio.to_thread(look))
            for count in [*range(40), 0]:
                fleet.replace([meter(f"m{at}", peer.url, unit=1) for at in range(count)])
                await output.write([])
            is_over.append(True)
            await looking
            assert cells(shown) == {}
