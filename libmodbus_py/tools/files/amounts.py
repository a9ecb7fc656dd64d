"""
Amounts that files write with their units, such as "90 days" and "2 GB".
"""

from __future__ import annotations

import re

from ...protocol.mistakes import Path, WrongType, WrongValue

__all__ = ["in_bytes", "in_seconds"]

_MINUTE, _HOUR, _DAY = 60, 3600, 86_400

_SECONDS: dict[str, int] = {
    **dict.fromkeys(("s", "second", "seconds"), 1),
    **dict.fromkeys(("min", "minute", "minutes"), _MINUTE),
    **dict.fromkeys(("h", "hour", "hours"), _HOUR),
    **dict.fromkeys(("d", "day", "days"), _DAY),
    **dict.fromkeys(("week", "weeks"), 7 * _DAY),
    **dict.fromkeys(("year", "years"), 365 * _DAY),
}

_BYTES: dict[str, int] = {
    "B": 1,
    "kB": 10**3,
    "MB": 10**6,
    "GB": 10**9,
    "TB": 10**12,
    "KiB": 1 << 10,
    "MiB": 1 << 20,
    "GiB": 1 << 30,
    "TiB": 1 << 40,
}

_AMOUNT = re.compile(r"\s*([0-9]{1,15}(?:\.[0-9]{1,9})?)\s*([A-Za-z]+)\s*")


def in_seconds(name: str | Path, text: object, low: str, high: str) -> float:
    """
    Return the seconds of an amount of time, such as "90 days" or "36 h".

    Args:
        name: the argument, or the path of the key.
        text: the amount.
        low, high: the smallest and the greatest amount that are allowed.

    Raises:
        TypeError: not a text.
        ValueError: not an amount of time, or out of range.
    """
    return _amount(name, text, _SECONDS, low, high, "a time")


def in_bytes(name: str | Path, text: object, low: str, high: str) -> int:
    """Return the bytes of a size, such as "2 GB" or "512 MiB"; otherwise as `in_seconds`."""
    return int(_amount(name, text, _BYTES, low, high, "a size"))


def _amount(
    name: str | Path, text: object, units: dict[str, int], low: str, high: str, what: str
) -> float:
    allowed = f'must be {what} in "{low}".."{high}"'
    if not isinstance(text, str):
        raise WrongType(name, f"{allowed}, not {type(text).__name__}")
    amount = _read(text, units)
    bounds = _read(low, units), _read(high, units)
    if amount is None or bounds[0] is None or bounds[1] is None:
        raise WrongValue(name, f"{allowed}, not {text[:40]!r}")
    if not bounds[0] <= amount <= bounds[1]:
        raise WrongValue(name, f"{allowed}, not {text[:40]!r}")
    return amount


def _read(text: str, units: dict[str, int]) -> float | None:
    found = _AMOUNT.fullmatch(text)
    if found is None or found[2] not in units:
        return None
    return float(found[1]) * units[found[2]]
