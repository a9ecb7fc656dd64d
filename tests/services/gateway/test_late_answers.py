"""
Units that do not answer, answer late, or answer something else, behind a gateway.
"""

import asyncio
from collections import Counter

from libmodbus_py import (
    AsyncClient,
    ExceptionResponse,
    Fault,
    Route,
    framing,
    pdu,
)
from tests.services.gateway.gates import LINE, gateway, small
from tests.simulation.scripted import Scripted, Write
from tests.simulation.stage import Stage
from tests.support.gateways import passage


def value(unit: int, address: int) -> int:
    """Return the value of a register of a unit, which no other register has."""
    return (unit * 10_000 + address) & 0xFFFF


def test_late_answers_are_never_anybody_elses(stage: Stage) -> None:
    """A unit whose every third answer comes after its timeout, and good ones beside it."""
    framer = framing.make_framer("rtu", "server")
    asked: Counter[int] = Counter()

    def answer(request: bytes, write: Write) -> None:
        unit, address = request[0], int.from_bytes(request[2:4], "big")
        asked[unit] += 1
        is_late = unit == 2 and asked[unit] % 3 == 0
        pdu = b"\3\2" + value(unit, address).to_bytes(2, "big")
        write(framer.encode(framing.Frame(unit, pdu)), after=0.6 if is_late else 0.0)

    Scripted(stage, LINE, answer)

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
