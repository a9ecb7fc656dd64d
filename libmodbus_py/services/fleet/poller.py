"""
One device while it is polled: the state of its poll, and of the device.
"""

from __future__ import annotations

from collections.abc import Collection
from enum import Enum
from typing import Any

from ...client.asynchronous import Submitted
from ...client.waiting_room import rest_after
from ...maps.register_map import PointPlan
from ...protocol.errors import ModbusError
from .config import DeviceConfig
from .readings import Changes, Quality, Reading, is_down, reason_of

__all__ = ["LONGEST_REST", "DeviceState", "Poller", "Reads"]

LONGEST_REST = 60.0
"""Seconds between two trials of a device that does not answer, unless its interval is longer."""


class DeviceState(Enum):
    """The state of a device."""

    NEW = "new"
    UP = "up"
    DOWN = "down"


class Reads:
    """
    The requests and points of a kind of device; thousands of devices share one object.

    Args:
        config: of one of these devices.
    """

    __slots__ = ("__weakref__", "names", "plan", "units")

    def __init__(self, config: DeviceConfig) -> None:
        self.plan: PointPlan = config.plan()
        self.names: tuple[str, ...] = config.names
        self.units: tuple[str, ...] = tuple(config.map[name].units for name in config.names)


class Poller:
    """
    Produces the requests of a device and takes their outcomes; sends nothing itself.

    Args:
        config: of the device.
        reads: the requests and points of the device.

    Attributes:
        state: NEW until its first poll is over.
        told_state: the state that the statistics count.
        error: the first error of the last poll; None if there was none.
        at: when the device is polled next, or was polled last.
        planned: when the current poll was due; None without one.
        misses: polls in a row without an answer.
        submitted: the request that is in flight, or None.
        asked_at: when the request in flight was sent.
        rest_until: when the next request may be sent to the device.
        waits_since: when the current poll was due.
    """

    # fmt: off
    __slots__ = (
        "_answers", "_changes", "asked_at", "at", "config", "error", "is_trial", "misses",
        "planned", "reads", "rest_until", "state", "submitted", "told_state", "waits_since",
    )
    # fmt: on

    def __init__(self, config: DeviceConfig, reads: Reads) -> None:
        self.config: DeviceConfig = config
        self.reads: Reads = reads
        self.state: DeviceState = DeviceState.NEW
        self.told_state: DeviceState = DeviceState.NEW
        self.error: Exception | None = None
        self.at: float = 0.0
        self.planned: float | None = None
        self.misses: int = 0
        self.is_trial: bool = False
        self.submitted: Submitted | None = None
        self.asked_at: float = 0.0
        self.rest_until: float = 0.0
        self.waits_since: float = 0.0
        self._answers: list[Any] = []
        self._changes = _changes(config, reads)

    @property
    def name(self) -> str:
        return self.config.name

    @property
    def unit(self) -> int:
        return self.config.unit

    @property
    def has_begun(self) -> bool:
        return bool(self._answers)

    @property
    def next_request(self) -> Any:
        """The next request; None when the poll is over."""
        asked = len(self._answers)
        return self.reads.plan.requests[asked] if asked < len(self.reads.plan.requests) else None

    def begin(self) -> None:
        """Begin a poll; earlier responses are dropped."""
        self._answers = []

    def take(self, outcome: Any) -> None:
        """Take a response or an error; a poll ends if its first request is not answered."""
        self._answers.append(outcome)
        if isinstance(outcome, ModbusError) and is_down(outcome) and not self._has_answered:
            self._answers = [outcome] * len(self.reads.plan.requests)

    @property
    def _has_answered(self) -> bool:
        return any(
            not isinstance(answer, ModbusError) or not is_down(answer) for answer in self._answers
        )

    def conclude(self, now: float) -> None:
        """End a poll: set the state of the device, its error and its rest."""
        errors = [answer for answer in self._answers if isinstance(answer, ModbusError)]
        self.error = errors[0] if errors else None
        self.misses = 0 if self._has_answered else self.misses + 1
        self.state = DeviceState.DOWN if self.misses else DeviceState.UP
        self.rest_until = now + self.config.spacing

    def readings(self, time: float) -> list[Reading]:
        """Return the readings of the poll."""
        reads, device = self.reads, self.config.name
        values = list(reads.plan.results(self._answers, return_exceptions=True).values())
        self._answers = []
        return [
            Reading(time, device, reads.names[at], *_told(values[at], reads.units[at]))
            for at in self._changes.pick(values)
        ]

    def withdrawn(self, time: float, still_read: Collection[str] = ()) -> list[Reading]:
        """Return readings that take back those that were reported, without the points named."""
        if self.state is DeviceState.NEW:
            return []
        return [
            Reading(time, self.name, name, None, unit, "offline")
            for name, unit in zip(self.reads.names, self.reads.units, strict=True)
            if name not in still_read
        ]

    def forget(self) -> None:
        """Forget the state of the device, and what was reported of it."""
        self.state = self.told_state = DeviceState.NEW
        self.error = None
        self._changes = _changes(self.config, self.reads)

    @property
    def pause(self) -> float:
        """Seconds that the device rests after a poll without an answer."""
        return rest_after(self.misses, self.config.interval, LONGEST_REST)

    @property
    def is_refused(self) -> bool:
        """True if the device answered, but refused a request."""
        return self.state is DeviceState.UP and self.error is not None


def _changes(config: DeviceConfig, reads: Reads) -> Changes:
    bands = config.dead_bands
    return Changes(config.on_change, [bands.get(name) for name in reads.names])


def _told(value: Any, unit: str) -> tuple[Any, str, Quality, str]:
    if isinstance(value, Exception):
        quality: Quality = "down" if is_down(value) else "bad"
        return None, unit, quality, reason_of(value)
    return value, unit, "good", ""
