"""
Topics and payloads of readings at an MQTT broker, and the last values that it retains there.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Protocol

from ....protocol.json_text import JSON
from ..readings import Reading
from .forms import payload
from .poll_messages import newest, poll_messages
from .topics import Topic

__all__ = ["Message", "Messages", "PointMessages", "PollMessages"]

Message = tuple[str, bytes]
"""A topic and a payload."""


class Messages(Protocol):
    """
    Makes messages of readings, and knows those that the broker retains.

    Its keys name what has one topic: points, or devices.
    """

    def of(self, readings: Sequence[Reading]) -> Iterator[Message]:
        """Yield the messages with readings."""
        ...

    def left(self, readings: Sequence[Reading]) -> Iterator[Message]:
        """Yield messages that take back retained values at topics with a former label."""
        ...

    def note(self, readings: Sequence[Reading]) -> None:
        """Note that the broker retains these readings."""
        ...

    def kept(self) -> dict[Hashable, list[Reading]]:
        """Return the last readings of each key."""
        ...

    def again(self, readings: Sequence[Reading]) -> Iterator[Message]:
        """Yield the messages with last readings."""
        ...

    def put_last(self, key: Hashable) -> bool:
        """Move last values behind all others; return False if there are none."""
        ...

    def forget(self, key: Hashable) -> str:
        """Forget last values; return what they were of, for the log."""
        ...


class PointMessages:
    """
    A message for each reading, at the topic of its point.

    Args:
        topic: of a point.
    """

    def __init__(self, topic: Topic) -> None:
        self._topic = topic
        self._kept: dict[Hashable, Reading] = {}
        self._topics: dict[Hashable, str] = {}

    def of(self, readings: Sequence[Reading]) -> Iterator[Message]:
        return (_message(self._topic_of(each), each) for each in readings)

    def left(self, readings: Sequence[Reading]) -> Iterator[Message]:
        if not self._topic.labels:  # which may have changed
            return
        for each in readings:
            key, topic = _point(each), self._topic_of(each)
            former = self._topics.get(key, topic)
            if former != topic:
                yield _message(former, _gone(each))
            self._topics[key] = topic

    def note(self, readings: Sequence[Reading]) -> None:
        for each in readings:
            if each.quality == "offline":
                self.forget(_point(each))
            else:
                self._kept[_point(each)] = each

    def kept(self) -> dict[Hashable, list[Reading]]:
        return {key: [each] for key, each in self._kept.items()}

    def again(self, readings: Sequence[Reading]) -> Iterator[Message]:
        return self.of(readings)

    def put_last(self, key: Hashable) -> bool:
        reading = self._kept.pop(key, None)
        if reading is not None:
            self._kept[key] = reading
        return reading is not None

    def forget(self, key: Hashable) -> str:
        reading = self._kept.pop(key, None)
        self._topics.pop(key, None)
        return f"{reading.name} of {reading.device}" if reading is not None else ""

    def _topic_of(self, reading: Reading) -> str:
        return self._topic.of(reading.labels, device=reading.device, name=reading.name)


class PollMessages:
    """
    A message for each poll of a device, at the topic of the device.

    Args:
        topic: of a device.
        is_retained: True to send the last values of the other points of the device, too: the
            broker retains one message of a topic.
        largest: the bytes that a message may have.
    """

    def __init__(self, topic: Topic, *, is_retained: bool, largest: int) -> None:
        self._topic = topic
        self._is_retained = is_retained
        self._largest = largest
        # The last reading of each point of a device.
        self._kept: dict[Hashable, dict[str, Reading]] = {}
        self._topics: dict[Hashable, str] = {}

    def of(self, readings: Sequence[Reading]) -> Iterator[Message]:
        ahead: dict[str, dict[str, Reading]] = {}
        for (device, _), group in groupby(readings, lambda each: each.poll):
            told = {each.name: each for each in group}
            if self._is_retained:
                told = {**ahead.get(device, self._kept.get(device, {})), **told}
                ahead[device] = _staying(told)
            last = list(told.values())
            yield from self._messages(self._topic_of(last), last)

    def left(self, readings: Sequence[Reading]) -> Iterator[Message]:
        if not self._topic.labels:  # which may have changed
            return
        for (device, _), group in groupby(readings, lambda each: each.poll):
            told = {**self._kept.get(device, {}), **{each.name: each for each in group}}
            topic = self._topic_of(list(told.values()))
            former = self._topics.get(device, topic)
            if former != topic:
                yield from self._messages(former, [_gone(each) for each in told.values()])
            self._topics[device] = topic

    def note(self, readings: Sequence[Reading]) -> None:
        for (device, _), group in groupby(readings, lambda each: each.poll):
            told = {each.name: each for each in group}
            staying = _staying({**self._kept.get(device, {}), **told})
            if staying:
                self._kept[device] = staying
            else:
                self.forget(device)

    def kept(self) -> dict[Hashable, list[Reading]]:
        return {key: list(each.values()) for key, each in self._kept.items()}

    def again(self, readings: Sequence[Reading]) -> Iterator[Message]:
        for _, group in groupby(readings, lambda each: each.device):
            last = list(group)
            yield from self._messages(self._topic_of(last), last)

    def put_last(self, key: Hashable) -> bool:
        kept = self._kept.pop(key, None)
        if kept is not None:
            self._kept[key] = kept
        return kept is not None

    def forget(self, key: Hashable) -> str:
        self._kept.pop(key, None)
        self._topics.pop(key, None)
        return f"the device {key!r}"

    def _topic_of(self, readings: Sequence[Reading]) -> str:
        last = newest(readings)
        return self._topic.of(last.labels, device=last.device)

    def _messages(self, topic: str, readings: Sequence[Reading]) -> Iterator[Message]:
        for _, data in poll_messages(readings, self._largest):
            yield topic, data


def _message(topic: str, reading: Reading) -> Message:
    return topic, JSON.encode(payload(reading)).encode()


def _point(reading: Reading) -> tuple[str, str]:
    return reading.device, reading.name


def _gone(reading: Reading) -> Reading:
    return reading._replace(value=None, quality="offline", reason="")


def _staying(told: Mapping[str, Reading]) -> dict[str, Reading]:
    return {name: each for name, each in told.items() if each.quality != "offline"}
