"""
The set-up that tests of devices share.
"""

from __future__ import annotations

from collections.abc import Callable

import pytest

from libmodbus_py import Device
from libmodbus_py.tools.simulator.device_file import parse
from tests.device.scaled import file_of


@pytest.fixture(params=["map", "file"])
def make(request: pytest.FixtureRequest) -> Callable[[], Device]:
    """Makes devices with `MAP` and `VALUES` of the test's module: of the map, or of a file."""
    points, values = request.module.MAP, request.module.VALUES

    def of_file() -> Device:
        device = parse(file_of(points, values)).devices
        assert isinstance(device, Device)
        return device

    return of_file if request.param == "file" else lambda: Device.of_map(points, values)
