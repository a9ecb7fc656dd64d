"""
Listeners, while the n-th call of the system fails: they hear what comes afterwards.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable

import pytest

from libmodbus_py.tools.listener.listener import listen
from tests.faults.injecting import Scenario, Trial, eventually, tried
from tests.faults.test_clients import on_line
from tests.faults.test_servers import LINE_ANSWER, LINE_REQUEST, line, port_of
from tests.support.peers import FakeServer

__all__ = ["line"]

SHORT = 0.05


def hearing(url: str, between: str | None, say: Callable[[str], None]) -> Scenario:
    """Listen to one transaction while calls fail, and to another when they do not any more."""

    def scenario(trial: Trial) -> None:
        with contextlib.ExitStack() as stack:
            heard = None
            with trial.faults():
                heard = stack.enter_context(listen(url, between=between))
                say(heard.url)
            if heard is not None:
                say(heard.url)
                assert next(heard).unit == 1
            with trial.faults():
                stack.close()

    return scenario


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for the next attempt."""
    monkeypatch.setattr("libmodbus_py.tools.listener.listener.REOPEN_AFTER", 0.001)


def test_a_listener_on_a_line(line: tuple[int, str]) -> None:
    far, path = line

    def say(url: str) -> None:
        os.write(far, LINE_REQUEST + LINE_ANSWER)

    tried(hearing(f"rtu://{path}?baudrate=115200", None, say), "tools.listener", "ports")


def is_passed_on(url: str) -> bool:
    with contextlib.suppress(OSError), socket.socket() as made:
        made.settimeout(SHORT)
        made.connect(port_of(url))
        made.send(LINE_REQUEST)
        return made.recv(300) == LINE_ANSWER
    return False


def test_a_listener_between_clients_and_a_device() -> None:
    def say(url: str) -> None:
        assert eventually(lambda: is_passed_on(url))

    with FakeServer(on_line) as device:
        between = f"rtu+tcp://127.0.0.1:{device.port}"
        scenario = hearing("rtu+tcp://127.0.0.1:0", between, say)
        # What listens can always be shut down, and that is what ends its thread.
        tried(scenario, "tools.listener", "ports", without="shut down")
