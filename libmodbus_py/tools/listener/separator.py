"""
Turns the bytes of one line or connection into transactions, without clocks or ports.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

from ...protocol.checks import checked_callback
from ...protocol.framing import AsciiFramer, RtuFramer, delimiter_after
from ...protocol.pdu import Diagnostics
from .hearing import Candidate, Damage, FramerHearing, Hearing, RtuHearing
from .naming import Naming
from .transaction import OnHeard, Transaction

__all__ = ["Direction", "LineFraming", "Separator"]

LineFraming = Literal["rtu", "ascii"]

# The sender of bytes, if it is known.
Direction = Literal["client", "server"]


# The longest gap inside a frame, in seconds: that of ASCII (serial line, 2.5.2.1), which is longer
# than that of RTU.
LONGEST_GAP = 1.0


class Separator:
    """
    Separates the bytes on a line into requests, responses and damage, and pairs them.

    Args:
        framing: "rtu" or "ascii".
        on_heard: called with a `Heard` for each frame as soon as it is known to be a request or a
            response, and for damaged bytes.
        pause: the seconds between two frames on an RTU line, as `pause_between_frames` returns;
            0 if bytes do not arrive at the pace of a serial line.

    Attributes:
        quiet: seconds without a byte after which `tick` should be called.

    Raises:
        ValueError: `framing` is wrong.
        TypeError: `on_heard` is not a function.
    """

    def __init__(
        self,
        framing: LineFraming,
        on_heard: OnHeard = lambda heard: None,
        pause: float = 0.0,
    ) -> None:
        if framing not in ("rtu", "ascii"):
            raise ValueError(f'framing must be "rtu" or "ascii", not {framing!r}')
        checked_callback("on_heard", on_heard)
        self._framing = framing
        self._pause = pause
        self._naming = Naming(on_heard)
        self._hearings: dict[Direction | None, Hearing] = {}
        self._ascii: list[AsciiFramer] = []
        self._last: dict[Direction | None, float] = {}
        self._is_quiet: set[Direction | None] = set()
        self.quiet: float = self._hearing(None).quiet

    def feed(self, data: bytes, at: float, direction: Direction | None = None) -> list[Transaction]:
        """
        Take received bytes, and return the transactions that have ended, oldest first.

        Args:
            data: the bytes, cut anywhere.
            at: the time at which they arrived, in seconds of any clock that never goes back.
            direction: the sender of the bytes, "client" or "server"; None if it is not known.
        """
        self._wait(at)
        if data:
            self._last[direction] = at
            self._is_quiet.discard(direction)
            found = self._hearing(direction).hear(data, at)
            self._take(found)
        return self._given()

    def tick(self, at: float) -> list[Transaction]:
        """Note that no more bytes arrived until this time; otherwise like `feed`."""
        self._wait(at)
        self._naming.tick(at)
        return self._given()

    def end(self) -> list[Transaction]:
        """Note that no more bytes will arrive; otherwise like `feed`."""
        for hearing in self._hearings.values():
            self._take(hearing.silence(is_long=True))
        self._last.clear()
        self._naming.end()
        return self._given()

    def take(self, found: Candidate | Damage) -> list[Transaction]:
        """Take a frame or damaged bytes that were separated before; otherwise like `feed`."""
        self._naming.take(found)
        return self._given()

    def _wait(self, at: float) -> None:
        for direction, last in list(self._last.items()):
            hearing = self._hearing(direction)
            is_long = at - last >= LONGEST_GAP
            if is_long or (at - last >= hearing.quiet and direction not in self._is_quiet):
                self._is_quiet.add(direction)
                self._take(hearing.silence(is_long=is_long))
            if is_long:
                del self._last[direction]

    def _take(self, found: Iterator[Candidate | Damage]) -> None:
        for each in found:
            self._naming.take(each)

    def _given(self) -> list[Transaction]:
        done, self._naming.pairing.done = self._naming.pairing.done, []
        for each in done:
            self._follow_delimiter(each)
        return done

    def _hearing(self, direction: Direction | None) -> Hearing:
        if direction not in self._hearings:
            self._hearings[direction] = self._made(direction)
        return self._hearings[direction]

    def _made(self, direction: Direction | None) -> Hearing:
        is_asking = None if direction is None else direction == "client"
        if self._framing == "ascii":
            framer = AsciiFramer()
            self._ascii.append(framer)
            return FramerHearing(lambda: framer, is_asking)
        if is_asking is None:
            return RtuHearing(self._pause)
        role: Direction = "server" if is_asking else "client"
        return FramerHearing(lambda: RtuFramer(role, self._pause), is_asking)

    def _follow_delimiter(self, done: Transaction) -> None:
        if self._ascii and isinstance(done.request, Diagnostics) and done.kind == "answered":
            for framer in self._ascii:
                framer.delimiter = delimiter_after(done.request.encode(), framer.delimiter)
