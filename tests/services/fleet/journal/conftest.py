"""The file of a journal, and disks that take no time or fail."""

from pathlib import Path

import pytest

from libmodbus_py.services.fleet.journal import journal, place
from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from tests.services.fleet.journal.journals import Failing, Inline


@pytest.fixture
def path(tmp_path: Path) -> str:
    return str(tmp_path / "fleet.db")


@pytest.fixture
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disks take no time."""
    monkeypatch.setattr(journal, "WriterThread", Inline)


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Failing:
    """Transactions may fail."""
    return Failing(monkeypatch, JournalFile, "write_polls")


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Failing:
    """Outputs may fail to read what is only on the disk, which are all readings but the last."""
    monkeypatch.setattr(place, "MOST_IN_MEMORY", 3)
    return Failing(monkeypatch, JournalFile, "read_polls")
