"""
Readiness: a service manager is told once a command serves.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.cli.serve.running import notify_ready
from tests.cli.serving import FLEET_OF_ONE
from tests.support.commands import Started


@pytest.fixture
def manager(tmp_path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(60)
        yield manager


@pytest.mark.parametrize("name", ["serve", "gateway", "poll"])
def test_each_command_tells_that_it_serves(
    name: str, device: str, manager: socket.socket, tmp_path: Path
) -> None:
    (tmp_path / "fleet.toml").write_text(FLEET_OF_ONE.format(url=device))
    arguments = {
        "serve": ["tcp://127.0.0.1:0"],
        "gateway": ["tcp://127.0.0.1:0", "--to", device],
        "poll": ["fleet.toml", "--json", "readings.json"],
    }[name]
    environment = {"NOTIFY_SOCKET": manager.getsockname()}
    with Started(name, *arguments, environment=environment, folder=tmp_path) as process:
        assert manager.recv(100) == b"READY=1"
        process.terminate()
        process.wait()


def test_an_abstract_socket_is_told_too(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("")  # Linux chooses an abstract name
        manager.settimeout(60)
        name = manager.getsockname()
        assert name[:1] == b"\0"
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name[1:].decode())
        notify_ready()
        assert manager.recv(100) == b"READY=1"


@pytest.mark.parametrize("place", ["", "relative", "/nowhere/notify", "@nobody", "/" + "x" * 200])
def test_a_manager_that_is_not_there_changes_nothing(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", place)
    before = os.listdir("/proc/self/fd")
    notify_ready()
    assert os.listdir("/proc/self/fd") == before
