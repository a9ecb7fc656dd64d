"""
Durations as people type them: 0.5, 500ms, 10s, 2m, 1h30m.
"""

from __future__ import annotations

import re

__all__ = ["DURATION", "duration_of"]

DURATION = "a number of seconds, or such as 500ms, 10s, 2m, 1h30m or 1d"
"""The texts that are durations, for errors."""

_SECONDS = {"ms": 0.001, "s": 1, "m": 60, "min": 60, "h": 3600, "d": 86_400}

_PART = r"([0-9]{1,9}(?:\.[0-9]{1,9})?)\s*(ms|s|min|m|h|d)\s*"


def duration_of(text: str) -> float:
    """
    Return the seconds of a duration.

    Raises:
        ValueError: the text is none.
    """
    if not re.fullmatch(f"(?:{_PART})+", text.strip(), re.ASCII):
        return float(text)
    parts = re.findall(_PART, text, re.ASCII)
    return float(sum(float(number) * _SECONDS[unit] for number, unit in parts))
