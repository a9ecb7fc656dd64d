"""
A fleet as a page shows it: values with their age, devices that are down, since when and why, and
devices that come and go while somebody looks.
"""

from __future__ import annotations

import asyncio
from typing import Any

from libmodbus_py import Fleet
from libmodbus_py.services.fleet.journal.journal_reader import HistoricalValue
from libmodbus_py.services.fleet.shown_fleet import PageOutput, ShownFleet
from tests.services.fleet.fleets import Peer, good, meter, simulated_run, until


def row_of(values: Any, device: str, name: str) -> Any:
    return next(row for row in values.rows() if (row.device, row.name) == (device, name))


def cells(table: Any) -> dict[str, list[Any]]:
    """The cells of each row, by the name of the row."""
    return {" ".join(row[0][:2]).strip(): row for row in map(table.cells, table.rows())}


def shown_of(fleet: Fleet, output: PageOutput) -> tuple[Any, Any]:
    values, devices = ShownFleet("plant", fleet, output).tables
    return values, devices


PAIR = [(1, "a"), (2, "b")]


def test_values_and_devices_also_of_one_that_is_down() -> None:
    silent: set[int] = set()

    async def answer(request: bytes) -> bytes | None:
        return None if request[6] in silent else await good(request)

    async def go() -> None:
        async with Peer(answer) as peer:
            devices = [meter(name, peer.url, unit=unit, timeout=0.1) for unit, name in PAIR]
            output = PageOutput()
            fleet = Fleet(devices, outputs=[output])
            values, states = shown_of(fleet, output)
            assert states.rows() == []
            async with fleet:
                assert [row[1][0] for row in cells(states).values()] == ["new", "new"]
                place = peer.url.partition("?")[0]
                assert [states.words(row) for row in states.rows()] == [f"a {place}", f"b {place}"]
                await until(lambda: fleet.statistics.up == 2)
                await until(lambda: len(cells(values)) == 6)
                await until(lambda: cells(values)["b power"][1] == "7")
                assert cells(values)["b power"][2:3] + cells(values)["b power"][6:7] == [
                    "W",
                    ["good", ""],
                ]
                up = cells(states)["b"]
                assert up[1] == ["up", "", ""]
                assert 0 < up[2] <= up[3]
                assert up[4:] == [2, "0.1 s", 3]
                told = fleet.devices["b"]
                assert up[2:4] == [round(told.since, 1), round(told.answered_at, 1)]

                silent.add(2)
                await until(lambda: fleet.statistics.down == 1)
                await until(lambda: cells(values)["b power"][6][0] == "down")
                down = cells(states)["b"]
                assert (down[1][0], "function 3" in down[1][1]) == ("down", False)
                assert "unit 2, function 3" in down[1][2]
                assert down[2] >= up[2]
                assert [each.name for each in states.rows() if states.is_trouble(each)] == ["b"]
                assert cells(values)["b power"][1:3] == ["-", "W"]
                assert [values.is_trouble(each) for each in values.rows()] == [False] * 3 + [
                    True
                ] * 3

                silent.clear()
                await until(lambda: cells(values)["b power"][1] == "7")

    simulated_run(go())


def test_a_value_that_is_only_reported_when_it_changes_is_as_old_as_the_last_poll() -> None:
    async def go() -> None:
        async with Peer() as peer:
            output = PageOutput()
            fleet = Fleet([meter("a", peer.url, on_change=True)], outputs=[output])
            values, _ = shown_of(fleet, output)
            async with fleet:
                await until(lambda: cells(values).get("a power", [0, 0])[1] == "7")
                row = row_of(values, "a", "power")
                polls = fleet.statistics.polls
                await until(lambda: fleet.statistics.polls > polls + 3)
                answered = fleet.devices["a"].answered_at
                assert answered > row.reading[0]
                assert values.cells(row)[7] == round(answered, 1)
                assert values.series(("a", "power"), "last values").is_stepped

    simulated_run(go())


def test_devices_that_are_replaced_while_somebody_looks() -> None:
    async def go() -> None:
        async with Peer() as peer:
            output = PageOutput()
            fleet = Fleet([meter("a", peer.url), meter("b", peer.url, unit=2)], outputs=[output])
            values, states = shown_of(fleet, output)
            async with fleet:
                await until(lambda: fleet.statistics.up == 2)
                await until(lambda: len(cells(values)) == 6)
                row = row_of(values, "b", "power")
                fleet.replace([meter("b", peer.url, unit=2), meter("c", peer.url, unit=3)])
                assert sorted(cells(states)) == ["b", "c"]
                await until(lambda: "c power" in cells(values))
                assert "a power" not in cells(values)
                assert row_of(values, "b", "power") is row  # with all its samples
                assert values.cells(row)[1] == "7"

    simulated_run(go())


def test_a_look_from_another_thread_does_not_disturb_a_fleet_that_changes() -> None:
    async def go() -> None:
        async with Peer() as peer:
            output = PageOutput()
            fleet = Fleet(outputs=[output])
            values, states = shown_of(fleet, output)

            def look() -> None:
                while not is_over:
                    cells(values), cells(states)

            async with fleet:
                looking = asyncio.create_task(asyncio.to_thread(look))
                for count in [*range(40), 0]:
                    fleet.replace([meter(f"m{at}", peer.url, unit=1) for at in range(count)])
                    await output.write([])
                is_over.append(True)
                await looking
                assert cells(states) == {}

    is_over: list[bool] = []
    simulated_run(go())


def test_readings_of_a_journal_are_found_if_there_is_one() -> None:
    fleet = Fleet([])

    def older(*_: object) -> list[HistoricalValue]:
        return []

    assert ShownFleet("plant", fleet, PageOutput(), older).older is older
    assert ShownFleet("plant", fleet, PageOutput()).older is None
