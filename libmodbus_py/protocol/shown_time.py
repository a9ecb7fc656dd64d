"""
Points in time, as outputs show them.

Files, JSON, CSV, logs and messages have ISO 8601 in UTC, so that they sort, and do not depend on
the place. Lines that a person watches have the clock of the place.
"""

from __future__ import annotations

__all__ = ["clock_text", "time_text"]


def time_text(seconds: float) -> str:
    """
    Return a time in ISO 8601, in UTC, with milliseconds, such as 2026-07-01T12:00:00.250Z.

    A time that no year of 1..9999 has is shown in seconds, such as 253402300800.000s.

    Args:
        seconds: since 1970, as `time.time` returns them.
    """
    from datetime import UTC, datetime  # which most commands never load

    try:
        shown = datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
    except (OverflowError, ValueError, OSError):  # of a year that datetime, or the system, lacks
        return _seconds_text(seconds)
    return f"{shown[:-6]}Z"


def clock_text(seconds: float, *, with_milliseconds: bool = False) -> str:
    """
    Return the time of day at this place, such as 14:00:00 or 14:00:00.250; else as `time_text`.

    Args:
        seconds: since 1970, as `time.time` returns them.
    """
    from datetime import datetime

    whole, part = divmod(round(seconds * 1000), 1000)
    try:
        clock = datetime.fromtimestamp(whole).strftime("%H:%M:%S")
    except (OverflowError, ValueError, OSError):  # as in `time_text`
        return _seconds_text(seconds)
    return f"{clock}.{part:03}" if with_milliseconds else clock


def _seconds_text(seconds: float) -> str:
    return f"{seconds:.3f}s"
