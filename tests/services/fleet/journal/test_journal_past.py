"""
The past of a value from a journal, for the chart of a page: numbers, and gaps.
"""

from __future__ import annotations

from pathlib import Path

from libmodbus_py.services.fleet.journal.journal_file import JournalFile
from libmodbus_py.services.fleet.journal.journal_reader import past_in
from libmodbus_py.services.fleet.journal.polls import numbered
from tests.services.fleet.journal.journals import readings


def test_numbers_and_gaps_of_a_value(tmp_path: Path) -> None:
    path = str(tmp_path / "fleet.db")
    file = JournalFile(path, 1e9, 10**9)
    file.open([])
    try:
        told = [(1, 5.5, "good"), (2, None, "down"), (3, "text", "good"), (4, 7, "good")]
        for at, value, quality in told:
            poll = [each._replace(time=float(at), value=value) for each in readings()]
            file.write(numbered([each._replace(quality=quality) for each in poll], at * 10), {}, 0)  # type: ignore[arg-type]
        assert past_in(path)("a", "p1", 0.0, 9.0, 100) == [
            (1.0, 5.5),
            (2.0, None),
            (3.0, None),
            (4.0, 7.0),
        ]
        assert past_in(path)("a", "p1", 3.5, 9.0, 100) == [(4.0, 7.0)]
    finally:
        file.close()


def test_a_journal_that_cannot_be_read_has_no_past(tmp_path: Path) -> None:
    assert past_in(str(tmp_path / "none.db"))("a", "p1", 0.0, 9.0, 100) == []
