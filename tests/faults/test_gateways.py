"""
Gateways, while the n-th call of the system fails: whoever asks afterwards is answered.
"""

from __future__ import annotations

import socket

import pytest

from libmodbus_py import Gateway, Route
from tests.faults.injecting import Scenario, Trial, tried
from tests.faults.test_clients import each_echoed, on_line
from tests.faults.test_servers import TCP_ANSWER, ask_while_failing, over
from tests.support.peers import FakeServer, FakeUnit

PART = ("services.gateway", "server", "client", "ports", "device")

# A line is asked again after so long, and a client waits for it.
TIMEOUT = 0.02

ask = over(socket.SOCK_STREAM)


def passing(device: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        background = Gateway([Route(device)]).background("tcp://127.0.0.1:0")
        ask_while_failing(trial, background, ask, TCP_ANSWER)

    return scenario


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for the next attempt."""
    monkeypatch.setattr("libmodbus_py.server.peers.RETRY_AFTER", 0.001)


def test_a_gateway_from_tcp_to_tcp() -> None:
    with FakeServer(each_echoed) as server:
        tried(passing(f"{server.url}?timeout={TIMEOUT}&max_pause=0"), *PART)


def test_a_gateway_from_tcp_to_a_serial_line() -> None:
    with FakeUnit(on_line) as unit:
        url = f"rtu://{unit.path}?baudrate=115200&timeout={TIMEOUT}&max_pause=0"
        tried(passing(url), *PART)
