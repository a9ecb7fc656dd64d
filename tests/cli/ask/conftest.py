"""A meter and its map, for the tests of the commands that ask."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.cli import serving


@pytest.fixture
def device() -> Device:
    return serving.meter()


@pytest.fixture
def mapping(device: Device) -> Mapping:
    return device.mapping


@pytest.fixture
def url(device: Device) -> Iterator[str]:
    with Server({1: device}).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@pytest.fixture
def meter(tmp_path: Path) -> str:
    path = tmp_path / "meter.csv"
    path.write_text(serving.METER)
    return str(path)
