"""
Progress and results of scans and searches, in words.
"""

from __future__ import annotations

from ..tools.scan.scan import Progress
from ..tools.scan.search import Extent, Searching

__all__ = ["duration", "missing", "progress"]


def progress(state: Progress | Searching, found: int = 0) -> str:
    """
    Return the progress of a scan or a search as one line.

    Args:
        found: units that the scan has found.
    """
    if isinstance(state, Searching):
        table = state.table.replace("_", " ")
        return f"unit {state.unit}, {table}: request {state.requests} of {state.most_requests}"
    return (
        f"{state.setting}: unit {state.unit}; {state.done} of {state.total} asked, {found} found, "
        f"{duration(state.left)} left at most"
    )


def missing(extent: Extent) -> str:
    """Return what a search may have missed in a table; empty if nothing."""
    parts = [f"ended by {extent.ended}"] * bool(extent.ended)
    if extent.unseen:
        parts.append(f"ranges of up to {extent.unseen} may have been missed")
    return ", ".join(parts)


def duration(seconds: float) -> str:
    """Return a number of seconds in words, such as "4.2 s" or "3 min 5 s"."""
    if seconds < 10:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
