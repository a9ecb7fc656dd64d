"""
Servers for the tests of commands: one of the command line, a device in this process, and what is
typed for others.
"""

from collections.abc import Iterator

import pytest

from libmodbus_py import Device, Mapping, Server
from tests.cli.serving import serving


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    with serving("serve", "tcp://127.0.0.1:0") as (_, url):
        yield url


@pytest.fixture
def device() -> Iterator[str]:
    with Server(Device(Mapping(holding_registers=10))).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@pytest.fixture(params=["serve", "gateway"])
def command(request: pytest.FixtureRequest, device: str) -> list[str]:
    """A command that serves without a file, up to the URL where it listens."""
    return ["serve"] if request.param == "serve" else ["gateway", "--to", device]
