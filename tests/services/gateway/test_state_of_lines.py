"""
What a gateway tells of the connection of a line, how soon it is back, and how a line ends.
"""

from __future__ import annotations

import asyncio

import pytest

from libmodbus_py import Context, Route, Server
from libmodbus_py.services.gateway.line import GatewayLine
from tests.services.gateway.gates import LINE, adu, gated, gateway, small
from tests.services.gateway.test_line import Asker, Plant, answer_of
from tests.simulation.stage import Stage
from tests.support.events import Events

WRITE_ALL = bytes.fromhex("06 0001 0007")


def test_since_when_a_line_is_down_or_open(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = Plant("tcp://10.0.0.1")
    plant.url = plant.peer.url
    clock = iter(range(100, 1000))
    monkeypatch.setattr("time.time", lambda: float(next(clock)))

    async def main() -> None:
        seen: list[tuple[bool, float]] = []
        for is_there in (True, False, False, True, True):
            if is_there:
                plant.network.listen(plant.url, plant.peer._accept)
            else:
                plant.network.unlisten(plant.url)
                plant.peer.drop_all()
            plant.ask(1, Asker())
            await asyncio.sleep(5)
            statistics = plant.line.statistics
            seen.append((bool(statistics.trouble), statistics.since))
        open_first, down, still_down, open_again, still_open = seen
        assert [is_down for is_down, _ in seen] == [False, True, True, False, False]
        assert 0 < open_first[1] < down[1] < open_again[1]
        assert (still_down, still_open) == (down, open_again)

    plant.run(main)


def test_a_trial_without_an_answer_leaves_the_unit_due() -> None:
    """A device that is to listen only says nothing (application protocol, 6.8.1)."""
    plant = Plant()

    async def main() -> None:
        plant.silent.add(9)
        plant.ask(9, Asker())
        await asyncio.sleep(2)
        told, asker = Asker(), Asker()
        plant.ask(9, told, "08 0004 0000")
        await asyncio.sleep(1)
        assert told.answers == [None]
        plant.silent.clear()
        plant.ask(9, asker)
        await asyncio.sleep(1)
        assert asker.answers == [answer_of(9, 3)]

    plant.run(main)


def test_a_request_without_an_answer_to_a_unit_that_answers_is_no_silence() -> None:
    plant = Plant()

    async def main() -> None:
        told = Asker()
        plant.ask(1, told, "08 0004 0000")
        await asyncio.sleep(1)
        assert told.answers == [None]
        assert (plant.unit(1).timeouts, plant.unit(1).answers) == (0, 0)

    plant.run(main)


def test_a_line_that_is_lost_at_each_request_is_opened_every_two_seconds() -> None:
    """The pause that doubles each time, a fifth shorter at random, is no longer than that."""
    plant = Plant("tcp://10.0.0.1")
    plant.url = plant.peer.url
    plant.peer.on_request = lambda request, write: plant.peer.drop_all()

    async def main() -> None:
        asker = Asker()
        for _ in range(200):
            plant.ask(1, asker)
            await asyncio.sleep(0.5)
        assert set(asker.answers) == {"830b"}
        assert 100 / 2 <= plant.peer.connections <= 100 / 1.6 + 6

    plant.run(main)


def test_a_unit_that_had_little_of_the_timeout_is_not_silent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Because the connection took most of it."""
    monkeypatch.setattr("tests.simulation.network.CONNECTING", 0.8)
    plant = Plant("tcp://10.0.0.1")
    plant.url = f"{plant.peer.url}?timeout=1"
    plant.delay = 0.3

    async def main() -> None:
        asker = Asker()
        plant.ask(1, asker)
        await asyncio.sleep(1.5)
        assert asker.answers == ["830b"]
        assert (plant.unit(1).timeouts, plant.unit(1).is_silent) == (1, False)
        plant.ask(1, asker)
        await asyncio.sleep(1)
        assert asker.answers[1:] == [answer_of(1, 2)]

    plant.run(main)


def test_a_unit_that_had_most_of_the_timeout_is_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    """From half of it on."""
    for connecting, is_silent in ((0.4, True), (0.6, False)):
        monkeypatch.setattr("tests.simulation.network.CONNECTING", connecting)
        plant = Plant("tcp://10.0.0.1")
        plant.url = f"{plant.peer.url}?timeout=1"
        plant.silent.add(1)

        async def main(plant: Plant = plant, is_silent: bool = is_silent) -> None:
            plant.ask(1, Asker())
            await asyncio.sleep(1.5)
            assert (plant.unit(1).timeouts, plant.unit(1).is_silent) == (1, is_silent)

        plant.run(main)


def test_a_client_that_is_gone_has_its_broadcast_recorded_once(stage: Stage) -> None:
    events = Events()
    with gated(stage, audit=events.append) as (gate, _, url, _):
        with stage.talk(url) as other, stage.talk(url) as client:
            other.sendall(adu(bytes.fromhex("03 0000 0001")))
            assert stage.until(lambda: gate.asked)
            client.sendall(adu(WRITE_ALL, unit=0))
            stage.pass_time(1)
            assert events == []
            client.close()
            stage.pass_time(1)
            assert [each.unit for each in events] == [0]
            gate.open()
            stage.pass_time(5)
        writes = [each for each in events if each.unit == 0]
        assert len(writes) == 1


def test_lines_that_were_replaced_are_closed(stage: Stage) -> None:
    route = Route(f"{LINE}?timeout=1", "1")
    with Server({1: small()}).background(LINE), gateway([route]) as (made, url):
        with Context.from_url(url, unit=1, timeout=5) as context:
            assert context.read_holding_registers(0, 1) == [0]
        for number in (1, 2, 3):
            made.change_routes([Route(f"tcp://10.0.0.{number}:502", "1")])
            stage.pass_time(1)
            assert list(made.traffic.lines) == [f"tcp://10.0.0.{number}:502"]
            assert not made._closing
        made.change_routes([route])


def test_a_gateway_has_ended_when_all_its_lines_are_closed(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = ["tcp://10.0.0.1:502", "tcp://10.0.0.2:502"]
    closed: list[str] = []
    close = GatewayLine.close

    async def slowly(line: GatewayLine) -> None:
        await asyncio.sleep(50 if line.url == lines[0] else 1)
        await close(line)
        closed.append(line.url)

    monkeypatch.setattr(GatewayLine, "close", slowly)
    with gateway([Route(lines[0], "1")]) as (made, _):
        made.change_routes([Route(lines[1], "1")])
        stage.pass_time(1)
        assert closed == []
    assert sorted(closed) == lines
