"""
The past of values from a journal, for charts.
"""

from __future__ import annotations

from functools import partial

from ...protocol.logs import HarmlessLogger
from ...tools.page.table_source import Older
from .journal.errors import JournalError
from .journal.journal_reader import history

__all__ = ["past_in"]

logger: HarmlessLogger = HarmlessLogger(__name__)


def past_in(path: str) -> Older:
    """Return a function that finds the numbers of a value in a journal; None is a gap."""
    return partial(_past, path)


def _past(
    path: str, device: str, name: str, since: float, until: float, most: int
) -> list[tuple[float, float | None]]:
    try:
        found = history(path, device, name, since, until, most)
    except JournalError as error:
        logger.info("%s: %s", path, error)
        return []
    return [
        (each.time, each.value if isinstance(each.value, int | float) else None) for each in found
    ]
