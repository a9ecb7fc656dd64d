"""
Units that do not answer, answer late, or answer something else, behind a gateway.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Collection

import pytest

from libmodbus_py import (
    AsyncClient,
    ExceptionResponse,
    Fault,
    Route,
    framing,
    pdu,
)
from tests.services.gateway.gates import LINE, READ_ONE, adu, gateway, small
from tests.simulation.scripted import Scripted, Write
from tests.simulation.stage import Stage
from tests.support.gateways import passage


def value(unit: int, address: int) -> int:
    """Return the value of a register of a unit, which no other register has."""
    return (unit * 10_000 + address) & 0xFFFF


def bus(
    stage: Stage,
    units: set[int],
    late: dict[int, int] | None = None,
    seconds: float = 0.0,
    damaged: Collection[int] = (),
) -> Scripted:
    """
    Units on a line that answer reads of one register.

    Args:
        units: those that there are; they may come and go.
        late: unit -> every so manieth answer of it comes so many seconds later.
        damaged: units whose first answer has a wrong CRC.
    """
    framer = framing.make_framer("rtu", "server")
    asked: Counter[int] = Counter()

    def answer(request: bytes, write: Write) -> None:
        unit, address = request[0], int.from_bytes(request[2:4], "big")
        if unit not in units:
            return
        asked[unit] += 1
        data = framer.encode(framing.Frame(unit, b"\3\2" + value(unit, address).to_bytes(2, "big")))
        if unit in damaged and asked[unit] == 1:
            data = data[:-2] + b"\0\0"
        every = (late or {}).get(unit, 0)
        write(data, after=seconds if every and asked[unit] % every == 0 else 0.0)

    return Scripted(stage, LINE, answer)


def test_late_answers_are_never_anybody_elses(stage: Stage) -> None:
    """A unit whose every third answer comes after its timeout, and good ones beside it."""
    bus(stage, {1, 2, 3}, late={2: 3}, seconds=0.6)

    async def poll(client: AsyncClient, unit: int, first: int) -> tuple[int, int]:
        right = failed = 0
        for at in range(first, first + 60):
            try:
                got = await client.for_unit(unit).read_holding_registers(at, 1)
            except ExceptionResponse:
                failed += 1
                continue
            assert got == [value(unit, at)]
            right += 1
        return right, failed

    with gateway([Route(f"{LINE}?timeout=0.5")]) as (made, url):

        async def all_of_them() -> list[tuple[int, int]]:
            async with (
                AsyncClient(url, timeout=10) as one,
                AsyncClient(url, timeout=10) as other,
            ):
                jobs = [poll(one, 1, 0), poll(one, 2, 300), poll(other, 3, 500), poll(other, 2, 7)]
                return await asyncio.gather(*jobs)

        found = stage.wait(all_of_them())
        assert [right for right, _ in found[::2]] == [60, 60]
        assert sum(failed for _, failed in found[1::2]) > 0
        (line,) = made.traffic.lines.values()
        assert line.units[2].answers > 0
        stage.pass_time(1)
        assert line.connection.late_answers > 0


def test_a_damaged_answer_has_its_unit_wait_and_nobody_else(stage: Stage) -> None:
    """The line must be silent before that unit is asked again; others need not wait for it."""
    heard = bus(stage, {1, 2, 3}, damaged={1})
    with gateway([Route(f"{LINE}?timeout=2")]) as (_, url), stage.talk(url) as client:
        client.sendall(adu(READ_ONE, 1, unit=1))
        assert client.receive(9) == adu(b"\x83\x0b", 1, unit=1)
        refused = stage.now
        client.sendall(adu(READ_ONE, 2, unit=1) + adu(READ_ONE, 3, unit=2))
        stage.pass_time(1)
        client.sendall(adu(READ_ONE, 4, unit=3))
        answers = client.receive(33)
        assert (answers[1], answers[12], answers[23]) == (3, 4, 2)
        assert heard.times[1] - refused < 0.01
        assert heard.times[2] - refused == pytest.approx(1, abs=0.01)
        assert heard.times[3] - refused == pytest.approx(2, abs=0.01)


def test_who_asks_again_without_ids_gets_the_answer_to_that_only(stage: Stage) -> None:
    """It has given up the first request: the answer to that would be taken for the second's."""
    device = small()
    device.mapping.holding_registers[:] = range(10)
    slow = {1: [Fault("delay", seconds=0.3)]}
    options = "timeout=5&max_in_flight=2"
    with (
        passage(
            "rtu+tcp", "tcp", {1: device}, faults=slow, line_options=options, stage=stage
        ) as through,
        stage.talk(through.url) as client,
    ):
        framer = framing.make_framer("rtu", "server")
        first, second = (
            framer.encode(framing.Frame(1, pdu.ReadHoldingRegisters(at, 1).encode()))
            for at in (3, 4)
        )
        client.sendall(first)
        stage.pass_time(0.05)
        client.sendall(second)
        assert client.receive(7)[3:5] == b"\0\4"
        stage.pass_time(3000)
        assert not client.has_input()
        (line,) = through.gateway.traffic.lines.values()
        assert line.unwanted == 1
