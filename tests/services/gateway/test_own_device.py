"""The unit of the gateway itself: what its registers say."""

import asyncio

import pytest

from libmodbus_py import Device, pdu
from libmodbus_py.client.statistics import Statistics
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.services.gateway.statistics import (
    GatewayStatistics,
    LineStatistics,
    UnitStatistics,
    own_device,
)


class Trial:
    def __init__(self) -> None:
        self.lines: dict[str, LineStatistics] = {}
        self.statistics = GatewayStatistics(self.lines)
        self.clients = ServerStatistics()
        self.units: dict[int, UnitStatistics] = {}
        self.device = asyncio.run(self._device())

    async def _device(self) -> Device:
        return own_device(self.statistics, self.clients, lambda unit: self.units.get(unit))

    def read(self, address: int, count: int) -> list[int]:
        request = pdu.ReadInputRegisters(address, count)
        return request.decode_response(self.device.answer(request.encode()))


@pytest.fixture
def trial() -> Trial:
    return Trial()


def words(*numbers: int) -> list[int]:
    return [word for number in numbers for word in divmod(number, 0x10000)]


def test_the_first_registers_have_the_counts_of_the_gateway(trial: Trial) -> None:
    statistics = trial.statistics
    statistics.requests, statistics.no_route, statistics.refused = 70_000, 2, 3
    statistics.malformed, statistics.broadcasts = 2**32 + 4, 5
    trial.clients.connections, trial.clients.refused = 6, 7
    trial.clients.bad_frames = 8
    trial.lines["a"] = LineStatistics("a", Statistics())
    assert trial.read(0, 22) == words(1, 1, 0, 6, 70_000, 7, 2, 3, 4, 5, 8)
    assert trial.read(22, 78) == [0] * 78


def test_the_registers_of_lines_begin_at_100(trial: Trial) -> None:
    for number in range(42):
        connection = Statistics(late_answers=1, timeouts=2, connects=3, lost=4)
        connection.failed_connects = 5
        line = LineStatistics(f"line {number}", connection)
        line.waiting, line.in_flight, line.full, line.unwanted = number + 1, 12, 13, 14
        trial.lines[line.url] = line
    rest = (12, 13, 1, 14, 2, 3, 9, 0, 0)
    assert trial.read(100, 20) == words(1, *rest)
    assert trial.read(120, 2) == words(2)
    assert trial.read(880, 20) == words(40, *rest)
    assert trial.read(900, 100) == [0] * 100  # there is room for 40
    trial.lines.clear()
    assert trial.read(100, 100) == [0] * 100


def test_the_registers_of_units_begin_at_1000(trial: Trial) -> None:
    unit = UnitStatistics(1, 4, 3, 5, 6, 7, 8, given_up=99, cached=9, merged=10)
    unit.seconds, unit.is_silent = 0.5, True
    trial.units = {0: unit, 1: UnitStatistics(requests=2), 255: unit}
    cells = words(1, 4, 3, 5, 6, 7, 8, 19, 125_000, 1)
    assert trial.read(1000, 20) == cells
    assert trial.read(1019, 4) == [cells[-1], *words(2), 0]
    assert trial.read(1000 + 255 * 20, 20) == cells
    assert trial.read(1040, 20) == [0] * 20  # these units were not asked


def test_the_own_device_has_only_input_registers_and_an_identification(trial: Trial) -> None:
    last = 1000 + 256 * 20
    assert trial.read(last - 1, 1) == [0]
    refused = trial.device.answer(pdu.ReadInputRegisters(last, 1).encode())
    assert refused == bytes([0x84, 2])
    refused = trial.device.answer(pdu.ReadHoldingRegisters(0, 1).encode())
    assert refused[0] == 0x83
    assert b"Gateway" in trial.device.answer(bytes([0x2B, 0x0E, 1, 0]))
