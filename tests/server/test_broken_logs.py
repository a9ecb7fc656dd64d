"""
Servers and gateways whose log handlers fail: clients are answered as if the log worked.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    Device,
    Gateway,
    IllegalFunction,
    Mapping,
    Route,
    Server,
    ServerDeviceFailure,
)

HERE = "tcp://127.0.0.1:0"


class Failing(logging.Handler):
    """A handler that fails, as a full disk or a log server that is away makes it."""

    records = 0

    def emit(self, record: logging.LogRecord) -> None:
        self.records += 1
        raise OSError("disk full")


@pytest.fixture
def log() -> Iterator[Failing]:
    """The handler that meets all that the package logs, at any level."""
    logger, handler = logging.getLogger("libmodbus_py"), Failing()
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    yield handler
    logger.removeHandler(handler)
    logger.setLevel(logging.NOTSET)


def fail(*_: object) -> Any:
    raise LookupError


def refuse(*_: object) -> bool:
    return False


def device(**hooks: Any) -> Device:
    return Device(Mapping(holding_registers=10), **hooks)


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp"])
@pytest.mark.parametrize("hook", ["before_read", "before_write", "after_write", "authorize"])
def test_a_hook_that_fails_is_answered(log: Failing, hook: str, scheme: str) -> None:
    is_read = hook == "before_read"
    with (
        Server(device(**{hook: fail}), trace=fail).background(f"{scheme}://127.0.0.1:0") as running,
        Client(running.urls[0], timeout=5) as client,
    ):
        for _ in range(3):
            with pytest.raises(ServerDeviceFailure):
                client.read_holding_registers(0, 1) if is_read else client.write_register(0, 1)
    assert log.records > 1


@pytest.mark.parametrize("authorize", [fail, refuse])
def test_a_refusal_of_a_gateway_is_answered(log: Failing, authorize: Any) -> None:
    with Server(device()).background(HERE) as behind:
        gateway = Gateway([Route(behind.urls[0])], authorize=authorize, trace=fail)
        with gateway.background(HERE) as running, Client(running.urls[0], timeout=5) as client:
            for _ in range(3):
                with pytest.raises((IllegalFunction, ServerDeviceFailure)):
                    client.read_holding_registers(0, 1)
    assert log.records > 1


def test_a_record_names_the_code_that_logged(caplog: pytest.LogCaptureFixture) -> None:
    device(before_read=fail).answer(b"\x03\x00\x00\x00\x01")
    (record,) = caplog.records
    assert (record.filename, record.funcName) == ("device.py", "_log_failure")
