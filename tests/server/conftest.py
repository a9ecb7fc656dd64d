"""Fixtures of the tests of servers."""

from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Server
from tests.support.events import Events


@pytest.fixture
def events() -> Events:
    """The events that a server records with `events.append`."""
    return Events()


@pytest.fixture
def port(device: Device) -> Iterator[int]:
    """The TCP port of a server, on which `device` is unit 17."""
    with Server({17: device}).background("tcp://127.0.0.1:0") as running:
        yield int(running.urls[0].rpartition(":")[2])
