"""
Metrics over HTTP for several at once: nobody waits for another who asks slowly or not at all.
"""

from __future__ import annotations

import contextlib
import socket
import urllib.request

import pytest

from libmodbus_py.services.integrations import exposition

pytest.importorskip("prometheus_client")

STALLED = 30


def test_those_who_stall_keep_nobody_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two servers of one program, and each has clients that never finish their request."""
    monkeypatch.setattr(exposition, "LIMIT", 3600.0)
    with contextlib.ExitStack() as stack:
        urls = [stack.enter_context(exposition.exposing("127.0.0.1", 0)) for _ in range(2)]
        for url in urls:
            port = int(url.split(":")[2].partition("/")[0])
            for _ in range(STALLED):
                stalled = stack.enter_context(socket.create_connection(("127.0.0.1", port)))
                stalled.sendall(b"GET /metrics HTTP/1.1\r\n")
        for url in urls * 3:
            with urllib.request.urlopen(url, timeout=60) as answer:
                assert answer.headers["Content-Type"].startswith("text/plain")
