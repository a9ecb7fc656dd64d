"""
Which poll the other side of an output refuses by ending the connection.
"""

from __future__ import annotations

from collections.abc import Sequence

from ..buffer import Buffer
from ..readings import Reading

__all__ = ["Refusals"]

# How often a poll is refused, each time right after another one was accepted, before it is dropped;
# one of a device whose last poll was dropped is refused once.
MOST = 3

# The most devices that are known to be refused.
MOST_KNOWN = 4096


class Refusals:
    """
    Compares the first poll that waits with those behind it.

    A connection that ends while readings are sent shows nothing about them: the other side may be
    away. They are refused if others are accepted right before, several times.

    Args:
        waiting: the readings that wait.
    """

    def __init__(self, waiting: Buffer) -> None:
        self._waiting = waiting
        self._suspect: tuple[str, float] | None = None
        self._count = 0
        self._at = 0
        self._is_compared = False
        # Devices whose last poll was dropped, and whether this connection accepted anything.
        self._known: dict[str, None] = {}
        self._has_accepted = False

    def note_open(self) -> None:
        """Note another connection."""
        self._has_accepted = False

    def note_accepted(self, readings: Sequence[Reading]) -> None:
        """Note readings that were accepted: nothing is suspected then."""
        if not readings:
            return
        self._has_accepted = True
        self.clear()
        if self._known:
            for device in {each.device for each in readings}:
                self._known.pop(device, None)

    def note_dropped(self, device: str) -> None:
        """Note a device one of whose polls was dropped."""
        self.clear()
        if len(self._known) >= MOST_KNOWN:
            self._known.clear()
        self._known[device] = None

    def is_doubtful(self, readings: Sequence[Reading]) -> bool:
        """Return True for several polls, of which one is likely to be refused."""
        if not self._known or all(each.device not in self._known for each in readings):
            return False
        return any(each.poll != readings[0].poll for each in readings)

    def suspect(self, readings: Sequence[Reading]) -> None:
        """Compare this poll, the first that waits, with others before it is sent again."""
        if self._suspect != readings[0].poll:
            self._count = self._at = 0
        self._suspect = readings[0].poll
        self._is_compared = False

    def clear(self) -> None:
        """Suspect no poll."""
        self._suspect = None
        self._count = self._at = 0

    async def others(self) -> list[Reading]:
        """
        Return another poll, to be sent before the suspected one; none if there is no reason to.

        It is not taken: sent again in its turn, it is the newest of its device in the end.
        """
        if self._suspect is None or self._is_compared:
            return []
        first, *others = await self._waiting.polls(self._at + 2) or [[]]
        if not first or first[0].poll != self._suspect:  # there was no room for it
            self._suspect = None
            return []
        if len(others) <= self._at:
            self._at = 0
        return others[self._at] if others else []

    def note_other(self, *, is_accepted: bool) -> None:
        """Note what became of the other poll; if it was lost too, the next time it is another."""
        self._is_compared = is_accepted
        self._has_accepted |= is_accepted
        if not is_accepted:
            self._at += 1

    def is_refused(self, readings: Sequence[Reading]) -> bool:
        """Note that readings were not accepted; return True if they are never going to be."""
        if any(each.poll != readings[0].poll for each in readings):
            return False
        is_known = readings[0].device in self._known
        if self._suspect == readings[0].poll and self._is_compared:
            self._count += 1
        return self._count >= (1 if is_known else MOST) or (is_known and self._has_accepted)
