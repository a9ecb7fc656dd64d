"""
Topics and payloads of readings at an MQTT broker, and what the broker retains of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

from ..readings import Reading
from .forms import object_text, poll_messages
from .topics import Topic

__all__ = ["OFFLINE", "ONLINE", "DeviceStates", "Message", "Messages", "State"]


class Message(NamedTuple):
    """A payload for a topic; with QoS 1 the broker acknowledges it."""

    topic: str
    payload: bytes
    qos: int = 1
    retain: bool = True


Last = dict[str, Reading]
"""Point -> its last reading; the one that came last has the labels of the topic."""

ONLINE, OFFLINE = b"online", b"offline"


class Messages:
    """
    Makes messages of readings, and keeps the last values, which the broker may lose.

    There is a message of up to `largest` bytes for each reading, or for each poll of a device. If
    it is retained, that of a device has the last values of its other points, too.
    """

    def __init__(
        self, topic: Topic, *, is_of_points: bool, qos: int, retain: bool, largest: int
    ) -> None:
        self._topic = topic
        self._is_of_points = is_of_points
        self._qos = qos
        self._retain = retain
        self._largest = largest
        # Device, or device and point -> what its topic retains, and will after these messages.
        self._kept: dict[tuple[str, ...], Last] = {}
        self._ahead: dict[tuple[str, ...], Last] = {}

    def of(self, readings: Sequence[Reading]) -> Iterator[Message]:
        """Yield the messages with readings, after those that take back values at former topics."""
        self._ahead = {}
        for key, last in self._groups(readings):
            if self._retain:
                before = self._ahead.get(key, self._kept.get(key, {}))
                last = {name: each for name, each in before.items() if name not in last} | last
                if before and self._topic.labels:
                    yield from self._taken_back(self._topic_of(before), last)
                self._ahead[key] = {
                    name: each for name, each in last.items() if each.quality != "offline"
                }
            yield from self._messages(self._topic_of(last), [*last.values()])

    def _taken_back(self, former: str, last: Last) -> Iterator[Message]:
        """Yield messages for a topic with a former label."""
        if former != self._topic_of(last):
            gone = [
                each._replace(value=None, quality="offline", reason="") for each in last.values()
            ]
            yield from self._messages(former, gone)

    def keep(self) -> None:
        """Keep the readings of the last messages: they were published."""
        self._kept.update(self._ahead)
        for key in [key for key, last in self._ahead.items() if not last]:
            self._kept.pop(key, None)

    def again(self) -> Iterator[Message]:
        """Yield the messages with the last values."""
        for last in self._kept.values():
            yield from self._messages(self._topic_of(last), [*last.values()])

    def _groups(self, readings: Sequence[Reading]) -> Iterator[tuple[tuple[str, ...], Last]]:
        if self._is_of_points:
            for each in readings:
                yield (each.device, each.name), {each.name: each}
        else:
            for (device, _), group in groupby(readings, lambda each: each.poll):
                yield (device,), {each.name: each for each in group}

    def _topic_of(self, last: Last) -> str:
        newest = next(reversed(last.values()))
        return self._topic.of(newest.labels, device=newest.device, name=newest.name)

    def _messages(self, topic: str, readings: Sequence[Reading]) -> Iterator[Message]:
        if self._is_of_points:
            payloads = (object_text(each).encode() for each in readings)
        else:
            payloads = (data for _, data in poll_messages(readings, self._largest))
        for payload in payloads:
            yield Message(topic, payload, self._qos, self._retain)


State = tuple[str, bool]
"""The topic of a device, and True if the device answers."""


class DeviceStates:
    """
    The devices that answer: one of their points was read, or refused, the last time. Without a
    topic there is nothing to publish about them.
    """

    def __init__(self, topic: Topic | None) -> None:
        self._topic = topic
        # Device -> its points that were answered the last time.
        self._answered: dict[str, set[str]] = {}
        # Their states at the broker, without those of removed devices.
        self.published: dict[str, State] = {}

    def changed(self, readings: Sequence[Reading]) -> dict[str, State]:
        """Return the states of the devices of readings that are to be published."""
        states: dict[str, State] = {}
        if self._topic is None:
            return states
        for each in readings:
            points = self._answered.setdefault(each.device, set())
            if each.quality in ("good", "bad"):
                points.add(each.name)
            else:
                points.discard(each.name)
            states[each.device] = self._topic.of(each.labels, device=each.device), bool(points)
        return {name: state for name, state in states.items() if self.published.get(name) != state}

    def messages(self, states: Mapping[str, State]) -> Iterator[Message]:
        """Yield the messages with states; a device whose labels have changed has two topics."""
        for name, (topic, answers) in states.items():
            former, _ = self.published.get(name, (topic, False))
            if former != topic:
                yield Message(former, OFFLINE)
            yield Message(topic, ONLINE if answers else OFFLINE)

    def keep(self, published: dict[str, State], readings: Sequence[Reading]) -> None:
        """Keep states that were published, and forget devices that are not polled any more."""
        self.published |= published
        for each in readings:
            if each.quality == "offline" and not self._answered.get(each.device):
                self._answered.pop(each.device, None)
                self.published.pop(each.device, None)
