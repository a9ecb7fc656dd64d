"""
What a server says when it listens, without a server.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from libmodbus_py.cli.serve.announcing import announcing


def test_localhost_is_open_to_nobody_else(capsys: pytest.CaptureFixture[str]) -> None:
    running = SimpleNamespace(urls=["udp://localhost:502", "tcp://plc.example:502"])
    announcing(None)(cast(Any, running))
    warning = capsys.readouterr().err
    assert "tcp://plc.example:502 can read and write" in warning
    assert "localhost" not in warning
