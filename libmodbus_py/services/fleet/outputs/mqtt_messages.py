"""
Topics and payloads of readings at an MQTT broker, and what the broker retains of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import groupby

from ..readings import Reading
from .forms import object_text, poll_messages
from .topics import Topic

__all__ = ["OFFLINE", "ONLINE", "DeviceStates", "Message", "Messages"]

Message = tuple[str, bytes]
"""A topic and a payload."""

Key = tuple[str, ...]
"""The names of what has one topic: a device and a point, or a device."""

ONLINE, OFFLINE = b"online", b"offline"


class Messages:
    """
    Makes messages of readings, and keeps the last values, which the broker may lose.

    Args:
        is_of_points: True for a message for each reading, False for one for each poll of a device.
        is_retained: True if the broker retains the last message of each topic. That of a device has
            the last values of its other points, too.
        largest: the bytes that a message may have.
    """

    def __init__(
        self, topic: Topic, *, is_of_points: bool, is_retained: bool, largest: int
    ) -> None:
        self._topic = topic
        self._is_of_points = is_of_points
        self._is_retained = is_retained
        self._largest = largest
        # The last reading of each point; its labels are those of the topic at which it is.
        self._kept: dict[Key, dict[str, Reading]] = {}

    def of(self, readings: Sequence[Reading]) -> Iterator[Message]:
        """Yield the messages with readings, after those that take back values at former topics."""
        ahead: dict[Key, dict[str, Reading]] = {}
        for key, found in self._groups(readings):
            if self._is_retained:
                before = ahead.get(key, self._kept.get(key, {}))
                found = _merged(before, found)
                yield from self._taken_back(list(before.values()), list(found.values()))
                ahead[key] = _staying(found)
            last = list(found.values())
            yield from self._messages(self._topic_of(last), last)

    def _taken_back(self, before: list[Reading], last: list[Reading]) -> Iterator[Message]:
        """Yield a message for a topic with a former label, where the broker retains values."""
        if not before or not self._topic.labels:
            return
        former = self._topic_of(before)
        if former != self._topic_of(last):
            gone = [each._replace(value=None, quality="offline", reason="") for each in last]
            yield from self._messages(former, gone)

    def keep(self, readings: Sequence[Reading]) -> None:
        """Keep readings that were published, if the broker retains them."""
        if not self._is_retained:
            return
        for key, found in self._groups(readings):
            staying = _staying(_merged(self._kept.get(key, {}), found))
            if staying:
                self._kept[key] = staying
            else:
                self._kept.pop(key, None)

    def again(self) -> Iterator[Message]:
        """Yield the messages with the last values."""
        for kept in self._kept.values():
            last = list(kept.values())
            yield from self._messages(self._topic_of(last), last)

    def _groups(self, readings: Sequence[Reading]) -> Iterator[tuple[Key, dict[str, Reading]]]:
        """Yield the readings of each message by the names of their points."""
        if self._is_of_points:
            for each in readings:
                yield (each.device, each.name), {each.name: each}
            return
        for (device, _), group in groupby(readings, lambda each: each.poll):
            yield (device,), {each.name: each for each in group}

    def _topic_of(self, readings: Sequence[Reading]) -> str:
        last = readings[-1]
        return self._topic.of(last.labels, device=last.device, name=last.name)

    def _messages(self, topic: str, readings: Sequence[Reading]) -> Iterator[Message]:
        if self._is_of_points:
            for each in readings:
                yield topic, object_text(each).encode()
            return
        for _, data in poll_messages(readings, self._largest):
            yield topic, data


def _merged(before: dict[str, Reading], found: dict[str, Reading]) -> dict[str, Reading]:
    """Return the last readings of a topic; those that came last, whose labels count, are last."""
    return {**{name: each for name, each in before.items() if name not in found}, **found}


def _staying(found: dict[str, Reading]) -> dict[str, Reading]:
    return {name: each for name, each in found.items() if each.quality != "offline"}


State = tuple[str, bool]
"""The topic of a device, and True if the device answers."""


class DeviceStates:
    """
    The devices that answer: at least one of their points was read, or refused, the last time.

    Attributes:
        published: device -> its state at the broker; without removed devices.
    """

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._answered: dict[str, set[str]] = {}
        self.published: dict[str, State] = {}

    def changed(self, readings: Sequence[Reading]) -> dict[str, State]:
        """Return the states of the devices of readings that are to be published."""
        for each in readings:
            points = self._answered.setdefault(each.device, set())
            if each.quality in ("good", "bad"):
                points.add(each.name)
            else:
                points.discard(each.name)
        states = {
            each.device: (
                self._topic.of(each.labels, device=each.device),
                bool(self._answered[each.device]),
            )
            for each in readings
        }
        return {name: state for name, state in states.items() if self.published.get(name) != state}

    def messages(self, states: dict[str, State]) -> Iterator[Message]:
        """Yield the messages with states; a device whose labels have changed has two topics."""
        for name, (topic, answers) in states.items():
            former, _ = self.published.get(name, (topic, False))
            if former != topic:
                yield former, OFFLINE
            yield topic, ONLINE if answers else OFFLINE

    def note(self, published: dict[str, State], readings: Sequence[Reading]) -> None:
        """Keep states that were published, and forget devices that are not polled any more."""
        self.published |= published
        for each in readings:
            if each.quality == "offline" and not self._answered.get(each.device):
                self._answered.pop(each.device, None)
                self.published.pop(each.device, None)
