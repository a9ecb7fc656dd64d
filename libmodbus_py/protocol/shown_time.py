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

    Args:
        seconds: since 1970, as `time.time` returns them.
    """
    from datetime import UTC, datetime  # which most commands never load

    return f"{datetime.fromtimestamp(seconds, UTC).isoformat(timespec='milliseconds')[:-6]}Z"


def clock_text(seconds: float, *, with_milliseconds: bool = False) -> str:
    """
    Return the time of day at this place, such as 14:00:00 or 14:00:00.250.

    Args:
        seconds: since 1970, as `time.time` returns them.
    """
    from datetime import datetime

    whole, part = divmod(round(seconds * 1000), 1000)
    clock = datetime.fromtimestamp(whole).strftime("%H:%M:%S")
    return f"{clock}.{part:03}" if with_milliseconds else clock
