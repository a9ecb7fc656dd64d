"""
Commands to devices that lack the function that writes one register.
"""

import asyncio
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Fleet,
    IllegalFunction,
    Mapping,
    Point,
    RegisterMap,
    Server,
    pdu,
)
from libmodbus_py.fleet import DeviceConfig


@pytest.mark.parametrize("place", ["device", "url", "point"])
def test_a_fleet_commands_a_device_that_takes_no_function_6(place: str) -> None:
    """The function is that of the point, of the device or of the URL."""
    asked: list[Any] = []

    def refuse(request: Any) -> None:
        asked.append(request)
        raise IllegalFunction

    mapping = Mapping(holding_registers=10)
    device = Device(mapping, handlers={pdu.WriteRegister: refuse})
    keys: Any = {"write_function": "multiple"}
    points = RegisterMap([Point("it", "holding_registers", 3, **keys if place == "point" else {})])

    async def write(url: str) -> None:
        config = DeviceConfig("pump", url, points, **keys if place == "device" else {})
        async with Fleet([config]) as fleet:
            await fleet.write("pump", {"it": 9})

    with Server(device).background("tcp://127.0.0.1:0") as running:
        url = running.urls[0]
        asyncio.run(write(f"{url}?write_function=multiple" if place == "url" else url))
        with Client(url) as plc:
            assert plc.read_holding_registers(3, 1) == [9]
    assert not asked
