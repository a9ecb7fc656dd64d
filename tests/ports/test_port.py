"""
A port that is lost is tried again, and the log says so once, and once that it is open.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.ports.port import Outage

GONE = ModbusConnectionError("no such device", errno=19)


def failing() -> None:
    raise GONE


@pytest.fixture
def outage() -> Outage:
    return Outage(logging.getLogger("test"), "rtu:///dev/line")


def test_it_is_told_once_and_again_when_it_is_over(
    outage: Outage, caplog: pytest.LogCaptureFixture
) -> None:
    for _ in range(2):
        for _ in range(3):
            outage.begin(GONE)
        assert outage.is_on
        for _ in range(2):
            outage.end()
        assert not outage.is_on
    told = ["rtu:///dev/line: no such device; trying again", "rtu:///dev/line: open again"]
    assert caplog.messages == told * 2


def test_it_lasts_until_the_port_can_be_opened(
    outage: Outage, caplog: pytest.LogCaptureFixture
) -> None:
    outage.begin(GONE)
    attempts: list[Callable[[], None]] = [failing, failing, lambda: None]
    assert [outage.try_to_end(each) for each in attempts] == [False, False, True]
    assert not outage.is_on
    assert len(caplog.messages) == 2


def test_other_errors_are_not_taken_for_a_port_that_is_gone(outage: Outage) -> None:
    def broken() -> None:
        raise RuntimeError

    outage.begin(GONE)
    with pytest.raises(RuntimeError):
        outage.try_to_end(broken)
    assert outage.is_on
