"""
Connections with frames of a line that return what is sent: counted each, and told once.
"""

from __future__ import annotations

import logging

import pytest

from libmodbus_py.ports.endpoint import parse
from libmodbus_py.server.limits import ServerStatistics
from libmodbus_py.server.service import Channel, Session
from libmodbus_py.server.without_echo import WithoutEcho


def never(channel: Channel) -> Session:
    raise AssertionError("no connection comes")


def test_the_first_of_many_is_told(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    statistics = ServerStatistics()
    endpoint = WithoutEcho(parse("rtu+tcp://10.0.0.1:502"), never, statistics)
    for count in (1, 2, 3):
        endpoint.note_echo()
        assert statistics.echoes == count
    (told,) = caplog.messages
    assert told.startswith("rtu+tcp://10.0.0.1:502: what is sent comes back")
