"""
The live page of a server, while the n-th call of the system fails.
"""

from __future__ import annotations

import contextlib
import socket

import pytest

from libmodbus_py.tools.page.page import live_page
from tests.faults.injecting import Scenario, Trial, eventually, tried
from tests.faults.test_servers import server

# Ready within milliseconds, or a fault took it away.
SHORT = 0.2


def got(url: str, path: str, until: bytes) -> bytes:
    """Return what comes for a request, up to some bytes in it."""
    where, _, token = url.partition("?")
    host, _, port = where.removeprefix("http://").strip("/").rpartition(":")
    found = b""
    with contextlib.suppress(OSError), socket.socket() as made:
        made.settimeout(SHORT)
        made.connect((host, int(port)))
        made.send(
            f"GET {path}?{token} HTTP/1.1\r\nHost: {host}:{port}\r\n"
            "Connection: close\r\n\r\n".encode()
        )
        while until not in found and (data := made.recv(65_536)):
            found += data
    return found


def is_shown(url: str) -> bool:
    return b"</html>" in got(url, "/", b"</html>") and b"data:" in got(url, "/events", b"data:")


def shown() -> Scenario:
    def scenario(trial: Trial) -> None:
        shown = server()
        with shown.background("tcp://127.0.0.1:0"), contextlib.ExitStack() as stack:
            page = None
            with trial.faults(OSError):
                page = stack.enter_context(live_page(shown))
                is_shown(page.url)
            if page is not None:
                assert eventually(lambda: is_shown(page.url))
            with trial.faults():
                stack.close()

    return scenario


def test_a_page_with_its_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("libmodbus_py.tools.timed_server.SWEEP", 0.005)
    monkeypatch.setattr("libmodbus_py.tools.page.streams.PERIOD", 0.005)
    tried(shown(), "tools.page")
