"""
The file of a journal, and disks that take no time.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from libmodbus_py.services.fleet.journal import journal
from tests.services.fleet.journal.journals import Inline


@pytest.fixture
def path(tmp_path: Path) -> str:
    return str(tmp_path / "fleet.db")


@pytest.fixture
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disks take no time."""
    monkeypatch.setattr(journal, "WriterThread", Inline)
