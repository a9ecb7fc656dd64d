"""
An output to an MQTT broker, and the commands that the broker passes on: values for points, and
their outcomes. It needs aiomqtt (the extra ``mqtt``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import TYPE_CHECKING

from ....protocol.checks import integer
from ....protocol.logs import HarmlessLogger
from ....protocol.mistakes import WrongValue
from ....tools.files.schema import flag
from ...other_servers import SecretFile, server_url
from ..commands import Commands
from ..config import DeviceConfig
from ..readings import MOST_KEPT, Reading
from .mqtt_connection import MqttConnection
from .mqtt_messages import OFFLINE, ONLINE, DeviceStates, Message, Messages
from .topics import Topic, plain_topic

if TYPE_CHECKING:
    import aiomqtt

__all__ = ["Mqtt"]


logger: HarmlessLogger = HarmlessLogger(__name__)

# Scheme -> port of a URL without one.
PORTS = {"mqtt": 1883, "mqtts": 8883}

# Connections in a row that may be lost while last values are published again: a broker that is away
# may cost one or two.
MOST_LOSSES = 3

# What a login is written in.
LOGIN = "user and password_file"

LARGEST_BYTES = 268_435_000
"""The size of a message that MQTT can carry, with a long topic."""


class Mqtt:
    """
    Publishes each reading to its own topic, or, if `topic` has no {name}, each poll of a device.

    The arguments are the keys of fleet files. The last values are published again after each
    connection, because a broker that was restarted may have lost them. Several workers have one
    `status`, which is "online" while one of them is connected.
    """

    def __init__(
        self,
        url: str,
        *,
        user: str | None = None,
        password: str | SecretFile | None = None,
        topic: str = "modbus/{device}/{name}",
        status: str = "modbus/status",
        device_status: str = "",
        retain: bool = True,
        qos: int = 0,
        ca: str | None = None,
        client_id: str | None = None,
        commands: bool = False,
        max_message: int | None = None,
        buffer: int = MOST_KEPT,
    ) -> None:
        server = server_url("url", url, PORTS, example="mqtt://192.0.2.1:1883", login=LOGIN)
        self.name: str = f"mqtt {server.place}"
        self.buffer: int = buffer
        if password is not None and user is None:
            raise WrongValue("user", "must be given with a password")
        if ca is not None and server.scheme != "mqtts":
            raise WrongValue("ca", "can only be used with mqtts://")
        flag(("retain",), retain)
        flag(("commands",), commands)
        self.exclusive: tuple[str, ...] = (f"the topic {topic!r} of {self.name}",)
        if client_id is not None:  # with which a broker has one connection
            self.exclusive += (f"the client_id {client_id!r} at {self.name}",)
        is_of_points = not isinstance(topic, str) or "{name}" in topic or "{device}" not in topic
        self._topic = Topic("topic", topic, ("device", "name") if is_of_points else ("device",))
        # The topic of a point, for commands.
        self._point = self._topic
        if not is_of_points:
            self._point = Topic("topic", f"{topic}/{{name}}", ("device", "name"))
        self._status = plain_topic("status", status)
        if self._status and self._topic.can_be(self._status):
            raise WrongValue("status", f"must not be the topic of a reading: {status!r}")
        self._state_topic: Topic | None = None
        if plain_topic("device_status", device_status):
            self._state_topic = Topic("device_status", device_status, ("device",))
            point = self._point.template
            others = [self._topic.template, self._status, f"{point}/set", f"{point}/set/result"]
            if any(self._state_topic.can_be(each) for each in others):
                reason = f"must not be another topic of this output: {device_status!r}"
                raise WrongValue("device_status", reason)
        self._states = DeviceStates(self._state_topic)
        self._qos = integer("qos", qos, 0, 1)
        if max_message is not None:
            integer("max_message", max_message, 1024, LARGEST_BYTES)
            if is_of_points or retain:
                reason = "needs a topic without {name}, and retain = false"
                raise WrongValue("max_message", reason)
        self._messages = Messages(
            self._topic,
            is_of_points=is_of_points,
            qos=self._qos,
            retain=retain,
            largest=max_message or LARGEST_BYTES,
        )
        self.takes_commands: bool = commands
        self._labels: dict[str, Mapping[str, str]] = {}
        self._commands: Commands | None = None
        self._offline = Message(self._status, OFFLINE) if self._status else None
        self._connection = MqttConnection(
            server, user, password, ca, client_id, self._offline, self._topic.filter
        )
        # Connections in a row that were lost while last values were published again.
        self._losses = 0

    @property
    def identity(self) -> str:
        """The name of its place in a journal."""
        return f"{self.name} {self._topic.template}"

    def shares(self, other: object) -> str | None:
        """Return what another output takes too, in words; None if there is nothing."""
        if not isinstance(other, Mqtt) or other.name != self.name:
            return None
        both = self.takes_commands and other.takes_commands
        if not both or not self._point.can_be(other._point.template):
            return None
        topics = f"{self._topic.template!r} and {other._topic.template!r}"
        return f"topics of commands that can be the same: {topics} of {self.name}"

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Set the devices; ValueError if one lacks a label that a topic holds, and none is set."""
        for topic in filter(None, (self._topic, self._state_topic)):
            topic.check(devices)
        self._labels = {name: each.labels for name, each in devices.items()}

    def attach(self, commands: Commands) -> None:
        """Set the object that carries out commands."""
        self._commands = commands

    async def open(self) -> None:
        connection = self._connection
        await connection.open(self._hear)
        if self.takes_commands:  # before "online", at which programs may send commands
            await connection.subscribe(f"{self._point.filter}/set")
        if self._status:
            await connection.publish(Message(self._status, ONLINE))
            await connection.subscribe(self._status)
        # The broker may have been restarted, and may have lost what it retained; or it ended the
        # connection at these values each time before.
        self._losses += 1
        if self._losses <= MOST_LOSSES:
            last = chain(self._messages.again(), self._states.messages(self._states.published))
            await connection.publish_all(last)
        else:
            logger.error("%s ends connections at last values, which are left out", self.name)
        self._losses = 0

    async def write(self, readings: Sequence[Reading]) -> None:
        changed = self._states.changed(readings)
        messages = chain(self._messages.of(readings), self._states.messages(changed))
        await self._connection.publish_all(messages)
        self._messages.keep()
        self._states.keep(changed, readings)

    async def close(self) -> None:
        await self._connection.close(self._offline)

    async def _hear(self, message: aiomqtt.Message) -> None:
        """Answer a command, or the last will of another worker or of an earlier connection."""
        topic = str(message.topic)
        if topic == self._status:
            if message.payload == OFFLINE:
                await self._connection.publish(Message(self._status, ONLINE))
        elif self._commands is not None and not message.retain:  # a retained one is old
            await self._answer(self._commands, topic, message.payload)

    async def _answer(self, commands: Commands, topic: str, payload: object) -> None:
        """Carry out a command, and publish its outcome."""
        asked = topic.removesuffix("/set")
        names = self._point.read(asked)
        # A rule of the broker that goes by a label must hold: only the own topic of a point counts.
        if names is None or self._point.of(self._labels.get(names["device"], {}), **names) != asked:
            return
        command = payload if isinstance(payload, bytes) else b""
        outcome = await commands.answer(names["device"], names["name"], command)
        if outcome is not None:
            result = Message(f"{topic}/result", outcome, self._qos, retain=False)
            await self._connection.publish(result)
