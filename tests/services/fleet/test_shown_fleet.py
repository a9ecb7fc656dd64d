"""
A fleet as a page shows it: outputs, values with their age, devices that are down, since when and
why, and devices that come and go while somebody looks.
"""

import asyncio
import math
import re
import struct
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

from prometheus_client import CollectorRegistry

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.services.fleet import statistics
from libmodbus_py.services.fleet.shown_fleet import PageOutput, ShownFleet, fleet_lines
from libmodbus_py.services.fleet.statistics import JournalStatistics
from libmodbus_py.services.integrations.prometheus import collect
from tests.services.fleet.fleets import Peer, good, in_simulated_time, meter, until
from tests.support.outputs import FakeOutput
from tests.tools.page.tables import name_of, state_of


def shown_fleet(
    *devices: DeviceConfig, outputs: Sequence[Any] = ()
) -> tuple[Fleet, ShownFleet, PageOutput]:
    page = PageOutput()
    fleet = Fleet(devices, outputs=[page, *outputs])
    return fleet, ShownFleet("plant", fleet, page), page


def rows(view: ShownFleet) -> dict[str, Any]:
    """Return the rows by their names."""
    names = [(row.cells()["name"], row) for row in view.rows()]
    return {f"{name['group']} {name['own']}".strip(): row for name, row in names}


def cells(view: ShownFleet) -> dict[str, dict[str, Any]]:
    return {name: row.cells() for name, row in rows(view).items()}


def problems(view: ShownFleet) -> list[str]:
    return [name for name, row in rows(view).items() if row.is_problem]


def value(view: ShownFleet, name: str) -> list[str]:
    value: dict[str, str] = cells(view).get(name, {}).get("value", {})
    return [*value.values()]


PAIR = [(1, "a"), (2, "b")]


@in_simulated_time
async def test_a_page_shows_values_and_devices_also_if_one_is_down() -> None:
    silent: set[int] = set()

    async def answer(request: bytes) -> bytes | None:
        return None if request[6] in silent else await good(request)

    async with Peer(answer) as peer:
        devices = [meter(name, peer.url, unit=unit, timeout=0.1) for unit, name in PAIR]
        fleet, view, _ = shown_fleet(*devices)
        assert view.rows() == []
        async with fleet:
            assert view.status() == ("2 of 2 devices have not answered yet (a, b)", True)
            await until(lambda: value(view, "b power") == ["7", "W"])
            await until(lambda: view.status() == ("all 2 devices answer", False))
            place = peer.url.partition("?")[0]
            assert list(rows(view))[:2] == ["a", "a voltage"]
            assert rows(view)["b"].words == f"b {place}"
            assert state_of(cells(view)["b power"]) == ["good", "", 0]
            up, device = cells(view)["b"], fleet.devices["b"]
            assert name_of(up) == ["b", f"{place}, unit 2"]
            assert state_of(up) == ["up", "", round(device.since, 1)]
            assert up["value"] == {"text": "3 points", "units": "every 0.1 s"}
            assert 0 < device.since <= device.answered_at
            assert up["age"] == round(device.answered_at, 1)
            assert problems(view) == []

            silent.add(2)
            await until(lambda: fleet.statistics.down == 1)
            await until(lambda: state_of(cells(view)["b power"])[0] == "down")
            assert view.status() == ("1 of 2 devices down (b)", True)
            word, reason, since = state_of(cells(view)["b"])
            assert word == "down"
            assert "no " in reason
            assert not any(text in reason for text in ("function", "ModbusTimeout"))
            assert since >= state_of(up)[2]
            assert problems(view) == ["b"]  # the device, and not each of its points
            assert value(view, "b power") == ["-", "W"]

            silent.clear()
            await until(lambda: value(view, "b power") == ["7", "W"])


# Points that answers of all zeros cannot be: none is implausible, and none is a number.
BAD = RegisterMap(
    [
        Point("level", "holding_registers", 0, units="m", missing=7),
        Point("flow", "holding_registers", 1),
        Point("x" * 99, "holding_registers", 2),
        Point("ratio", "holding_registers", 10, type="float32", access="read"),
    ]
)


@in_simulated_time
async def test_a_page_names_points_without_a_good_value() -> None:
    is_bad = True

    async def answer(request: bytes) -> bytes:
        reply = await good(request)
        if is_bad and request[9] == 10:
            return reply[:9] + struct.pack(">f", math.nan)
        return reply

    async with Peer(answer) as peer:
        device = meter("a", peer.url, map=BAD)
        fleet, view, _ = shown_fleet(device, meter("b", peer.url, unit=2))
        registry = CollectorRegistry()
        collect(fleet, registry=registry)
        labels = {"device": "a", "name": "level", "reason": "Missing"}
        async with fleet:
            await until(lambda: fleet.statistics.polls > 4)
            text = "points without a good value: 2 (a level, a ratio)"
            assert view.status() == (text, True)
            assert problems(view) == ["a level", "a ratio"]
            assert fleet.devices["a"].bad_points == {"level": "Missing", "ratio": "Missing"}
            assert registry.get_sample_value("modbus_fleet_bad_point", labels) == 1
            flow = {"device": "a", "name": "flow", "unit": ""}
            assert registry.get_sample_value("modbus_fleet_value", flow) == 7
            assert registry.get_sample_value("modbus_fleet_device_up", {"device": "a"}) == 1

            title, *lines = fleet_lines(fleet, "2 devices")
            assert title == ("2 devices", True)
            texts = [line.split() for line, _ in lines]
            assert texts[:2] == [["a", "level", "-", "(Missing)", "m"], ["a", "flow", "7"]]
            assert texts[4:5] == [["b", "voltage", "0.7", "V"]]
            assert max(len(line) for line, _ in lines) < 140
            is_bad = False
            await until(lambda: len(fleet.devices["a"].bad_points) == 1)
            assert fleet.devices["a"].bad_points == {"level": "Missing"}


@in_simulated_time
async def test_an_output_is_late_if_readings_waited_for_10_s(monkeypatch):
    now = asyncio.get_running_loop().time
    monkeypatch.setattr(statistics, "time", SimpleNamespace(monotonic=now))
    slow = FakeOutput("database", next=[30.0, 30.0])
    async with Peer() as peer:
        fleet, view, _ = shown_fleet(meter("a", peer.url), outputs=[slow])
        async with fleet:
            await until(lambda: view.status() == ("all 1 devices answer", False))
            start = now()
            await until(lambda: view.status()[1])
            assert 9 < now() - start < 11
            text, _ = view.status()
            assert re.fullmatch(r"output database is behind: [23]\d\d waiting", text), text
            assert problems(view) == ["output database"]
            assert state_of(cells(view)["output database"]) == ["behind", "", 0]
            await until(lambda: slow.batches[1:])
            await until(lambda: not view.status()[1])


@in_simulated_time
async def test_an_output_shows_what_waits_since_when_and_why() -> None:
    async with Peer() as peer:
        away = FakeOutput("database", is_away=True)
        fleet, view, _ = shown_fleet(meter("a", peer.url), outputs=[away])
        async with fleet:
            await until(lambda: fleet.statistics.outputs["database"].waiting > 20)
            assert next(iter(rows(view))) == "output database"
            assert "page" not in rows(view)
            first = cells(view)["output database"]
            assert state_of(first)[:2] == ["fails", "Connection refused"]
            assert int(first["value"]["text"]) > 20
            assert first["value"]["units"] == "waiting"
            failures = fleet.statistics.outputs["database"].failures
            await until(lambda: fleet.statistics.outputs["database"].failures > failures + 1)
            assert state_of(cells(view)["output database"]) == state_of(
                first
            )  # since the first failure
            assert state_of(first)[2] > 0
            assert problems(view) == ["output database"]
            assert view.status() == ("output database fails", True)
            away.is_away = False
            await until(lambda: away.accepted)
            await until(lambda: state_of(cells(view)["output database"]) == ["works", "", 0])
            assert problems(view) == []


def test_a_journal_that_fails_is_a_problem() -> None:
    fleet, view, _ = shown_fleet()
    fleet.statistics.journal = JournalStatistics()
    fleet.statistics.journal.bytes = 12_345_678
    assert state_of(cells(view)["journal"]) == ["works", "", 0]
    assert cells(view)["journal"]["value"] == {"text": "12.3", "units": "MB"}
    assert problems(view) == []
    fleet.statistics.journal.trouble = "No space left on device"
    assert problems(view) == ["journal"]
    assert state_of(cells(view)["journal"]) == ["fails", "No space left on device", 0]
    assert view.status() == ("journal fails", True)


@in_simulated_time
async def test_a_value_that_is_only_reported_when_it_changes_is_as_old_as_the_last_poll() -> None:
    async with Peer() as peer:
        fleet, view, _ = shown_fleet(meter("a", peer.url, on_change=True))
        async with fleet:
            await until(lambda: value(view, "a power") == ["7", "W"])
            row = rows(view)["a power"]
            polls = fleet.statistics.polls
            await until(lambda: fleet.statistics.polls > polls + 3)
            answer_time = fleet.devices["a"].answered_at
            assert answer_time > row.reading[0]
            assert row.cells()["age"] == round(answer_time, 1)
            series = view.series(("a", "power"), "last values")
            assert series is not None
            assert series.samples.every is None


@in_simulated_time
async def test_devices_may_be_replaced_while_a_page_is_open() -> None:
    async with Peer() as peer:
        fleet, view, _ = shown_fleet(meter("a", peer.url), meter("b", peer.url, unit=2))
        async with fleet:
            await until(lambda: value(view, "b power") == ["7", "W"])
            row = rows(view)["b power"]
            assert row.samples.every == 0.1
            fleet.replace([meter("b", peer.url, unit=2), meter("c", peer.url, unit=3)])
            await until(lambda: "c power" in rows(view))
            assert "a" not in rows(view)
            assert "a power" not in rows(view)
            assert rows(view)["b power"] is row  # with all its samples
            assert value(view, "b power") == ["7", "W"]


@in_simulated_time
async def test_a_page_in_another_thread_does_not_disturb_a_changing_fleet() -> None:
    is_over: list[bool] = []
    async with Peer() as peer:
        fleet, view, output = shown_fleet()

        def look() -> None:
            while not is_over:
                cells(view), view.status(), view.figures()

        async with fleet:
            looking = asyncio.create_task(asyncio.to_thread(look))
            for count in [*range(40), 0]:
                fleet.replace([meter(f"m{at}", peer.url, unit=1) for at in range(count)])
                await output.write_readings([])
            is_over.append(True)
            await looking
            assert cells(view) == {}
