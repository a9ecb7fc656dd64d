"""
Commands that an MQTT broker passes on: values for points, and their outcomes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..commands import Commands, encoded, wanted_of
from ..config import DeviceConfig
from .mqtt_messages import Message
from .topics import Topic

if TYPE_CHECKING:
    import aiomqtt

__all__ = ["MqttCommands"]


class MqttCommands:
    """
    Carries out the values published to the topic of a point + "/set". The outcome is published to
    this topic + "/result".

    Args:
        point: the topic of a point.

    Attributes:
        filter: the topic filter of all commands.
        commands: what carries them out; None until the fleet begins.
    """

    def __init__(self, point: Topic) -> None:
        self._point = point
        self._labels: dict[str, Mapping[str, str]] = {}
        self.filter: str = f"{point.filter}/set"
        self.commands: Commands | None = None

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Set the devices, by their names."""
        self._labels = {name: each.labels for name, each in devices.items()}

    def may_share(self, other: MqttCommands) -> bool:
        """Return True if one topic can be that of a command for both."""
        return self._point.can_be(other._point.template)

    async def answer(self, message: aiomqtt.Message) -> Message | None:
        """Carry out a command; return its outcome, or None if it is none of a point."""
        if self.commands is None or message.retain:  # a retained one is old
            return None
        topic = str(message.topic)
        asked = topic.removesuffix("/set")
        names = self._point.read(asked)
        # A rule of the broker that goes by a label must hold: only the own topic of a point counts.
        if names is None or self._point.of(self._labels.get(names["device"], {}), **names) != asked:
            return None
        data = message.payload if isinstance(message.payload, bytes) else b""
        outcome = await self.commands.answer(names["device"], names["name"], wanted_of(data))
        return None if outcome is None else (f"{topic}/result", encoded(outcome))
