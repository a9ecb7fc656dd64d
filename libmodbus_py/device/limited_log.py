"""Warnings that clients cause, and which must not fill the log."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ..protocol.logs import HarmlessLogger

INTERVAL_S = 60.0
"""Seconds between two lines or events of the same kind."""

MAX_REASONS = 100
"""Messages and reasons with lines of their own; further reasons share the line of their message."""


@dataclass(slots=True)
class _Reason:
    message: str
    ends: float  # the time from which on another line may be logged
    count: int = 0  # since the last line
    latest: tuple[object, ...] = ()


class LimitedLog:
    """
    Logs the first warning of a message and a reason at once, and then a line a minute at most: the
    latest one, with their number. This line comes when the minute is over, within `in_time`;
    elsewhere with the next warning after it. `clock` is used where no event loop has a time.
    """

    def __init__(self, logger: HarmlessLogger, clock: Callable[[], float] = time.monotonic) -> None:
        self._logger = logger
        self._clock = clock
        self._reasons: dict[tuple[str, str], _Reason] = {}

    def warning(self, message: str, *args: object, reason: str = "") -> None:
        """Log a warning, or count it; `reason` is the part of it that makes it another one."""
        try:
            loop = asyncio.get_running_loop()
        except RuntimeError:
            loop = None
        now = self._clock() if loop is None else loop.time()
        key = message, reason
        if key not in self._reasons and len(self._reasons) >= MAX_REASONS:
            self._log_counts(now)
            if len(self._reasons) >= MAX_REASONS:
                key = message, ""
        entry = self._reasons.setdefault(key, _Reason(message, now))
        entry.count, entry.latest = entry.count + 1, args
        if now >= entry.ends:
            self._log(entry, now)
        elif loop is not None and (timers := _timers.get(loop)) is not None:
            key_of_timer = self, entry.ends  # one timer for all reasons of that time
            if key_of_timer not in timers:
                timers[key_of_timer] = loop.call_at(entry.ends, self._end_minute, loop, entry.ends)

    def _end_minute(self, loop: asyncio.AbstractEventLoop, ends: float) -> None:
        del _timers[loop][self, ends]
        self._log_counts(ends)

    def _log_counts(self, now: float) -> None:
        """Log what was counted in minutes that are over, and forget reasons without any."""
        for key, entry in list(self._reasons.items()):
            if now >= entry.ends:
                if entry.count:
                    self._log(entry, now)
                else:
                    self._reasons.pop(key, None)

    def _log(self, entry: _Reason, now: float) -> None:
        if entry.count == 1:
            self._logger.warning(entry.message, *entry.latest)
        else:
            text = f"{entry.message}; %d since the last line like this"
            self._logger.warning(text, *entry.latest, entry.count)
        entry.count, entry.ends = 0, now + INTERVAL_S


_timers: dict[asyncio.AbstractEventLoop, dict[tuple[LimitedLog, float], asyncio.TimerHandle]] = {}


@contextlib.contextmanager
def in_time() -> Iterator[None]:
    """Let all logs that are used in this event loop log in time while the block runs."""
    loop = asyncio.get_running_loop()
    _timers.setdefault(loop, {})
    try:
        yield
    finally:
        for timer in _timers.pop(loop, {}).values():
            timer.cancel()
