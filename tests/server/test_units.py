"""
Which units a server answers for, and what it answers for others.
"""

from __future__ import annotations

import pytest

from libmodbus_py import (
    Context,
    Device,
    GatewayTargetFailedToRespond,
    Mapping,
    ModbusTimeoutError,
    Server,
    TcpContext,
)
from tests.simulation.stage import Stage


def test_unknown_unit_is_answered_with_exception_11_on_tcp(port: int) -> None:
    for native in (True, False):
        with TcpContext("127.0.0.1", port, unit=18, native=native) as context:
            for _ in range(2):
                with pytest.raises(GatewayTargetFailedToRespond):
                    context.read_coils(0, 1)


def test_one_device_answers_every_unit_on_tcp(device: Device) -> None:
    with (
        Server(device).background("tcp://127.0.0.1:0") as running,
        Context.from_url(running.urls[0]) as context,
    ):
        for unit in (0, 1, 2, 247, 248, 254, 255):
            for _ in range(2):
                assert context.for_unit(unit).read_holding_registers(100, 1) == [1000]


@pytest.mark.parametrize("kind", ["rtu", "ascii"])
def test_several_units_on_one_port_and_silence_for_others(stage: Stage, kind: str) -> None:
    devices = {unit: Device(Mapping(holding_registers=10, coils=8)) for unit in (1, 2)}
    line = f"{kind}:///dev/line?baudrate=115200"
    with Server(devices).background(line), Context.from_url(line, timeout=200) as context:
        for unit in (1, 2):
            context.for_unit(unit).write_register(0, unit)
        begun = stage.now
        with pytest.raises(ModbusTimeoutError):
            context.for_unit(3).read_coils(0, 1)
        assert stage.now - begun >= 200
        for unit in (1, 2):
            assert context.for_unit(unit).read_holding_registers(0, 1) == [unit]
        context.for_unit(0).write_registers(1, [7, 8])
        context.for_unit(0).write_coil(3, True)
        stage.pass_time(1)
        for device in devices.values():
            assert device.mapping.holding_registers[1:3] == [7, 8]
            assert device.mapping.coils[3]
