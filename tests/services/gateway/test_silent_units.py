"""Units that are silent or late behind a gateway, and what waits for them."""

import asyncio
import socket
from collections import Counter

from libmodbus_py import (
    AsyncClient,
    Device,
    ExceptionResponse,
    Fault,
    Gateway,
    Mapping,
    Route,
    Server,
    ServerDeviceBusy,
    framing,
    pdu,
)
from libmodbus_py.services.gateway.silent_units import SilentUnits, UnitState
from tests.services.gateway.gates import LINE, adu, gateway, small
from tests.simulation.lan import Lan
from tests.simulation.scripted import Scripted, Write
from tests.support.cases import each_case
from tests.support.gateways import passage

GOOD, PAUSED, DUE = UnitState.GOOD, UnitState.PAUSED, UnitState.DUE


def value(unit: int, address: int) -> int:
    """Return the value of a register of a unit, which no other register has."""
    return (unit * 10_000 + address) & 0xFFFF


def test_late_answers_go_to_no_other_request(lan: Lan) -> None:
    """A unit whose every third answer comes after its timeout, and good ones beside it."""
    framer = framing.make_framer("rtu", "server")
    counts: Counter[int] = Counter()

    def answer(request: bytes, write: Write) -> None:
        unit, address = request[0], int.from_bytes(request[2:4], "big")
        counts[unit] += 1
        is_late = unit == 2 and counts[unit] % 3 == 0
        pdu = b"\3\2" + value(unit, address).to_bytes(2, "big")
        write(framer.encode(framing.Frame(unit, pdu)), after=0.6 if is_late else 0.0)

    Scripted(lan, LINE, answer)

    async def poll(client: AsyncClient, unit: int, first: int) -> tuple[int, int]:
        right = failed = 0
        for at in range(first, first + 60):
            try:
                values = await client.for_unit(unit).read_holding_registers(at, 1)
            except ExceptionResponse:
                failed += 1
                continue
            assert values == [value(unit, at)]
            right += 1
        return right, failed

    with gateway([Route(f"{LINE}?timeout=0.5")]) as (gateway_, url):

        async def all_of_them() -> list[tuple[int, int]]:
            async with AsyncClient(url, timeout=10) as one, AsyncClient(url, timeout=10) as other:
                jobs = [poll(one, 1, 0), poll(one, 2, 300), poll(other, 3, 500), poll(other, 2, 7)]
                return await asyncio.gather(*jobs)

        results = lan.wait(all_of_them())
        assert [right for right, _ in results[::2]] == [60, 60]
        assert sum(failed for _, failed in results[1::2]) > 0
        (line,) = gateway_.traffic.lines.values()
        assert line.units[2].answers > 0
        lan.pass_time(1)
        assert line.connection.late_answers > 0


def test_a_repeated_request_without_an_id_gets_only_its_second_answer(
    lan: Lan,
) -> None:
    """It has given up the first request: the answer to that would be taken for the second's."""
    device = small()
    device.mapping.holding_registers[:] = range(10)
    slow = {1: [Fault("delay", seconds=0.3)]}
    options = "timeout=5&max_in_flight=2"
    with (
        passage(
            "rtu+tcp", "tcp", {1: device}, faults=slow, line_options=options, lan=lan
        ) as through,
        lan.client(through.url) as client,
    ):
        framer = framing.make_framer("rtu", "server")
        first, second = (
            framer.encode(framing.Frame(1, pdu.ReadHoldingRegisters(at, 1).encode()))
            for at in (3, 4)
        )
        client.sendall(first)
        lan.pass_time(0.05)
        client.sendall(second)
        assert client.receive(7)[3:5] == b"\0\4"
        lan.pass_time(3000)
        assert not client.has_input()
        (line,) = through.gateway.traffic.lines.values()
        assert line.unwanted == 1


READ, WRITE = bytes.fromhex("03 0001 0001"), bytes.fromhex("06 0001 004D")


@each_case(
    "target", ["tcp?busy_retries=1", "tcp?busy_retries=1&max_in_flight=4", "rtu+tcp?busy_retries=1"]
)
def test_a_write_waits_for_the_repetition_of_the_read_before_it(target: str) -> None:
    """Both requests arrive together; the device is busy when the read comes first."""
    busy = [True]

    def before_read(access: object) -> None:
        if busy:
            busy.pop()
            raise ServerDeviceBusy

    scheme, _, options = target.partition("?")
    device = Device(Mapping(holding_registers={0: [0, 5]}), before_read=before_read)
    with Server(device).background(f"{scheme}://127.0.0.1:0") as behind:
        gateway = Gateway([Route(f"{behind.urls[0]}?{options}")])
        with gateway.background("tcp://127.0.0.1:0") as running:
            host, port = running.urls[0].removeprefix("tcp://").split(":")
            with socket.create_connection((host, int(port)), timeout=10) as client:
                client.sendall(adu(READ, 1) + adu(WRITE, 2))
                answers = adu(bytes.fromhex("03 02 0005"), 1) + adu(WRITE, 2)
                assert client.makefile("rb").read(len(answers)) == answers


def test_requests_in_flight_with_the_first_silence_do_not_extend_the_pause() -> None:
    units = SilentUnits(1.0)
    assert units.note_silence(3, 3, 0.0)
    assert not units.note_silence(3, 3, 1.0)
    assert units.state(3, 3, 2.0) is UnitState.DUE
