"""A broker for the tests of fleets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from libmodbus_py.services import tasks
from libmodbus_py.services.fleet.outputs import writer

if TYPE_CHECKING:
    from tests.services.fleet.outputs.brokers import Broker


@pytest.fixture
def broker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Broker]:
    """A mosquitto that runs; outputs try again sooner than they do for users."""
    from tests.services.fleet.outputs.brokers import Broker  # MQTT's client is an extra

    monkeypatch.setattr(tasks, "FIRST_PAUSE_S", 0.01)
    monkeypatch.setattr(tasks, "LONGEST_PAUSE_S", 0.05)
    monkeypatch.setattr(writer, "LONGEST_SILENCE_S", 0.1)
    server = Broker(tmp_path)
    server.start()
    yield server
    server.close()
