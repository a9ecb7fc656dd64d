"""
Names of devices and points as levels of NATS subjects and MQTT topics.
"""

from __future__ import annotations

import re
from urllib.parse import unquote

from ...maps.point_checks import MAX_NAME
from .config import LONGEST_NAME

__all__ = ["Levels"]

_LONGEST = max(MAX_NAME, LONGEST_NAME)


class Levels:
    """
    Spells names as levels; different names have different levels.

    Args:
        special: a regular expression for the characters that are written as %2F and so on. It
            matches %.
    """

    def __init__(self, special: str) -> None:
        self._special = re.compile(special, re.ASCII)

    def spell(self, name: str) -> str:
        """Return the level of a name."""
        return self._special.sub(lambda found: f"%{ord(found[0]):02X}", name)

    def read(self, level: str) -> str | None:
        """
        Return the name of a level; None if `spell` returns no such level.

        A broker compares levels, not names: if ``n%6Frth`` were taken for ``north``, a rule that
        denies ``north`` would not hold.
        """
        if len(level) > 12 * _LONGEST:
            return None
        name = unquote(level)
        is_name = 1 <= len(name) <= _LONGEST and name.isprintable()
        return name if is_name and self.spell(name) == level else None
