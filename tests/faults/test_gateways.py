"""
Gateways, while the n-th call of the system fails: whoever asks afterwards is answered.
"""

from __future__ import annotations

import contextlib
import socket

import pytest

from libmodbus_py import Gateway, Route
from tests.faults.injecting import Scenario, Trial, eventually, tried
from tests.faults.test_clients import each_echoed, on_line
from tests.faults.test_servers import TCP_ANSWER, over
from tests.support.peers import FakeServer, FakeUnit

PART = ("services.gateway", "server", "client", "ports", "device")

# A line is asked again after so long, and a client waits for it.
TIMEOUT = 0.02

ask = over(socket.SOCK_STREAM)


def passing(device: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        gateway = Gateway([Route(device)])
        background = gateway.background("tcp://127.0.0.1:0")
        with contextlib.ExitStack() as stack:
            running = None
            with trial.faults(RuntimeError):
                running = stack.enter_context(background)
                ask(running.urls[0])
                ask(running.urls[0])
            if running is not None:
                assert eventually(lambda: ask(running.urls[0]) == TCP_ANSWER)
            with trial.faults():
                stack.close()

    return scenario


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for the next attempt."""
    monkeypatch.setattr("libmodbus_py.server.tcp.RETRY_AFTER", 0.001)


def test_a_gateway_from_tcp_to_tcp() -> None:
    with FakeServer(each_echoed) as server:
        found = tried(passing(f"{server.url}?timeout={TIMEOUT}&max_pause=0"), *PART)
    assert not found, "\n".join(found)


def test_a_gateway_from_tcp_to_a_serial_line() -> None:
    with FakeUnit(on_line) as unit:
        url = f"rtu://{unit.path}?baudrate=115200&timeout={TIMEOUT}&max_pause=0"
        found = tried(passing(url), *PART)
    assert not found, "\n".join(found)
