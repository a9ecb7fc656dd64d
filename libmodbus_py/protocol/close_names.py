"""
Names that are close to one that is not known.
"""

from __future__ import annotations

from collections.abc import Iterable

__all__ = ["close_to"]


def close_to(name: object, known: Iterable[str], prefix: str = "") -> str:
    """
    Return the end of a message about a name that is not known: those that are close to it.

    Args:
        prefix: printed before each of them.
    """
    from difflib import get_close_matches

    close = get_close_matches(name, known, 3) if isinstance(name, str) else []
    return f"; did you mean {' or '.join(prefix + each for each in close)}?" if close else ""
