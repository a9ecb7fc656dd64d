"""
Signal handlers of a program that calls a command: they are the same when the command has ended.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.cli.serve import fleet as workers
from tests.cli.serving import FLEET_OF_ONE
from tests.support.commands import run

NUMBERS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def own_handler(number: int, frame: object) -> None:
    raise AssertionError(f"nobody sends signal {number}")


@pytest.fixture
def handlers() -> Iterator[Callable[[], list[Any]]]:
    """Set handlers of a program, and return a function that asks which there are."""
    before = {number: signal.signal(number, own_handler) for number in NUMBERS}
    yield lambda: [signal.getsignal(number) for number in NUMBERS]
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.fixture
def file(tmp_path: Path) -> Iterator[Path]:
    with Server(Device(Mapping(holding_registers=1))).background("tcp://127.0.0.1:0") as running:
        (tmp_path / "fleet.toml").write_text(FLEET_OF_ONE.format(url=running.urls[0]))
        yield tmp_path / "fleet.toml"


def test_poll_restores_the_handlers(file: Path, handlers: Callable[[], list[Any]]) -> None:
    assert run("poll", file, "--once").code == 0
    assert handlers() == [own_handler] * 3


class NoPolling:
    """A worker that has nothing to do."""

    def __init__(self, *_: object, **__: object) -> None:
        self.fleet = SimpleNamespace(statistics=None)

    def engine_changed(self) -> None: ...

    def leave(self) -> None: ...

    async def run(self) -> None:
        assert signal.getsignal(signal.SIGTERM) is not own_handler


async def answer(*_: object, **__: object) -> tuple[None, None]:
    return None, None


def test_a_worker_restores_the_handlers(
    file: Path, handlers: Callable[[], list[Any]], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("connected", "disconnect", "_opened"):
        monkeypatch.setattr(workers, name, answer)
    monkeypatch.setattr(workers, "Polling", NoPolling)
    assert run("poll", file, "--engine", "nats://127.0.0.1:1").code == 0
    assert handlers() == [own_handler] * 3
