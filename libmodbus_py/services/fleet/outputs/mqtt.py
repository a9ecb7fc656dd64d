"""
An output to an MQTT broker, what the broker retains of readings, and the commands that it passes
on: values for points, and their outcomes. It needs aiomqtt (the extra ``mqtt``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain, groupby
from typing import TYPE_CHECKING, Literal

from ....files.schema import flag
from ....protocol.checks import integer
from ....protocol.logs import HarmlessLogger
from ....protocol.mistakes import WrongValue
from ...other_servers import SecretFile, server_url
from ..commands import Commands
from ..config import DeviceConfig
from ..readings import MOST_KEPT, Reading
from .discovery import PREFIX, Discovery, Topics
from .forms import object_text, poll_messages
from .mqtt_connection import Message, MqttConnection
from .output import Output
from .topics import Topic, plain_topic

if TYPE_CHECKING:
    import aiomqtt


logger: HarmlessLogger = HarmlessLogger(__name__)

# Scheme -> port of a URL without one.
PORTS = {"mqtt": 1883, "mqtts": 8883}

# Connections in a row that may be lost while last values are published again: a broker that is away
# may cost one or two.
MOST_LOSSES = 3

# What a login is written in.
LOGIN = "user and password_file"

ONLINE, OFFLINE = b"online", b"offline"

LARGEST_BYTES = 268_435_000
"""The size of a message that MQTT can carry, with a long topic."""

Last = dict[str, Reading]
"""Point -> its last reading; the one that came last has the labels of the topic."""

State = tuple[str, bool]
"""The topic of a device, and True if the device answers."""


class Mqtt(Output):
    """
    Publishes each reading to its own topic, or, if `topic` has no {name}, each poll of a device.

    The arguments are the keys of fleet files. The last values are published again after each
    connection, because a broker that was restarted may have lost them. Several workers have one
    `status`, which is "online" while one of them is connected. With `discovery`, Home Assistant
    gets configurations of all points (`Discovery`).
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
        discovery: Literal["homeassistant"] | None = None,
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
        device_status = plain_topic("device_status", device_status)
        if discovery is not None:
            topics = {"topic": topic, "status": status, "device_status": device_status}
            _check_discovery(discovery, topics, has_all=is_of_points or retain)
            self.exclusive += (f"the status {status!r} of {self.name} for discovery",)
            device_status = device_status or f"{status}/{{device}}/state"
        self._state_topic: Topic | None = None
        if device_status:
            self._state_topic = Topic("device_status", device_status, ("device",))
            point = self._point.template
            others = [self._topic.template, self._status, f"{point}/set", f"{point}/set/result"]
            if any(self._state_topic.can_be(topic) for topic in others):
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
        self._discovery: Discovery | None = None
        if discovery is not None and self._state_topic is not None:
            states = self._state_topic
            self._discovery = Discovery(
                Topics(self._status, states, self._topic, self._point, is_of_points, commands)
            )
        self._has_begun = False  # it was open before
        # False if another poller or worker of this status is connected, whose configurations may be
        # among those that are left.
        self._is_alone, self._is_heard = True, False
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

    def shares(self, other: Output) -> str | None:
        """Return what another output takes too, in words; None if there is nothing."""
        if not isinstance(other, Mqtt) or other.name != self.name:
            return None
        both = self.takes_commands and other.takes_commands
        if not both or not self._point.can_be(other._point.template):
            return None
        topics = f"{self._topic.template!r} and {other._topic.template!r}"
        return f"topics of commands that can be the same: {topics} of {self.name}"

    def describe_devices(self, devices: Mapping[str, DeviceConfig]) -> None:
        """Set the devices; ValueError if one lacks a label that a topic holds, and none is set."""
        for topic in filter(None, (self._topic, self._state_topic)):
            topic.check(devices)
        self._labels = {name: config.labels for name, config in devices.items()}
        if self._discovery is not None:
            self._discovery.describe(devices)

    def attach_commands(self, commands: Commands) -> None:
        self._commands = commands

    async def open_output(self) -> None:
        connection = self._connection
        await connection.open(self._take_message)
        if self.takes_commands:  # before "online", at which programs may send commands
            await connection.subscribe(f"{self._point.filter}/set")
        if self._status:
            self._is_alone, self._is_heard = True, False
            await connection.subscribe(self._status)
            await connection.publish(Message(self._status, ONLINE))
        if not self._has_begun:
            # Once, whatever happens: a broker may drop its responses behind many thousand messages.
            self._has_begun = True
            await self._begin_discovery()
        # The broker may have been restarted, and may have lost what it retained; or it ended the
        # connection at these values each time before.
        self._losses += 1
        if self._losses <= MOST_LOSSES:
            last = chain(
                () if self._discovery is None else self._discovery.last_messages(),
                self._messages.last_messages(),
                self._states.messages(self._states.published),
            )
            await connection.publish_all(last)
        else:
            logger.error("%s ends connections at last values, which are left out", self.name)
        self._losses = 0

    async def write_readings(self, readings: Sequence[Reading]) -> None:
        changes = self._states.changed(readings)
        messages = chain(self._messages.of(readings), self._states.messages(changes))
        leftovers: set[str] = set()
        devices: Mapping[str, DeviceConfig | None] = {}
        if self._discovery is not None:
            leftovers = self._discovery.leftovers(is_alone=self._is_alone)
            devices = self._discovery.changed(readings)
            deletions = (Message(topic, b"") for topic in leftovers)
            messages = chain(deletions, self._discovery.messages(devices), messages)
        await self._connection.publish_all(messages)
        if self._discovery is not None:
            self._discovery.keep_devices(devices, readings, leftovers)
        self._messages.keep_readings()
        self._states.keep_states(changes, readings)

    async def close_output(self) -> None:
        await self._connection.close(self._offline)

    async def _begin_discovery(self) -> None:
        """Publish all configurations soon, and ask for those that an earlier run left."""
        if self._discovery is not None and self._discovery.devices:  # a worker has none at first
            self._discovery.start()
            await self._connection.read_retained(self._discovery.filter, self._discovery.add_topic)

    async def _take_message(self, message: aiomqtt.Message) -> None:
        """Answer a command, or the last will of another worker or of an earlier connection."""
        topic = str(message.topic)
        if topic == self._status:
            if message.payload == ONLINE:
                # One that is retained is of before, and the first other one is the own.
                self._is_alone = not (message.retain or self._is_heard)
                self._is_heard = True
            elif message.payload == OFFLINE and not message.retain:
                await self._connection.publish(Message(self._status, ONLINE))
        elif self._commands is not None and not message.retain:  # a retained one is old
            await self._answer(self._commands, topic, message.payload)

    async def _answer(self, commands: Commands, topic: str, payload: object) -> None:
        base = topic.removesuffix("/set")
        names = self._point.read(base)
        # A rule of the broker that goes by a label must hold: only the own topic of a point counts.
        if names is None or self._point.of(self._labels.get(names["device"], {}), **names) != base:
            return
        command = payload if isinstance(payload, bytes) else b""
        outcome = await commands.answer(names["device"], names["name"], command)
        if outcome is not None:
            result = Message(f"{topic}/result", outcome, self._qos, retain=False)
            await self._connection.publish(result)


def _check_discovery(discovery: object, topics: Mapping[str, str], *, has_all: bool) -> None:
    """Raise WrongValue for what Home Assistant could not understand."""
    if discovery != PREFIX:
        raise WrongValue("discovery", f"must be {PREFIX!r}, not {discovery!r}")
    for key, topic in topics.items():
        if topic.startswith(f"{PREFIX}/"):
            where = "where configurations for discovery are"
            raise WrongValue(key, f"must not begin with {PREFIX}/, {where}")
    if not topics["status"]:
        raise WrongValue("status", "must not be empty with discovery: it shows that all are gone")
    if not has_all:  # a message would lack points that were not due
        raise WrongValue("retain", "must be true with discovery and a topic without {name}")


# --- retained messages --------------------------------------------------------------------------


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
                last = {name: row for name, row in before.items() if name not in last} | last
                if before and self._topic.labels:
                    yield from self._taken_back(self._topic_of(before), last)
                self._ahead[key] = {
                    name: reading for name, reading in last.items() if reading.quality != "offline"
                }
            yield from self._messages(self._topic_of(last), [*last.values()])

    def _taken_back(self, former: str, last: Last) -> Iterator[Message]:
        """Yield messages for a topic with a former label."""
        if former != self._topic_of(last):
            values = [
                row._replace(value=None, quality="offline", reason="") for row in last.values()
            ]
            yield from self._messages(former, values)

    def keep_readings(self) -> None:
        """Keep the readings of the last messages: they were published."""
        self._kept.update(self._ahead)
        for key in [key for key, last in self._ahead.items() if not last]:
            self._kept.pop(key, None)

    def last_messages(self) -> Iterator[Message]:
        for last in self._kept.values():
            yield from self._messages(self._topic_of(last), [*last.values()])

    def _groups(self, readings: Sequence[Reading]) -> Iterator[tuple[tuple[str, ...], Last]]:
        if self._is_of_points:
            for reading in readings:
                yield (reading.device, reading.name), {reading.name: reading}
        else:
            for (device, _), group in groupby(readings, lambda reading: reading.poll):
                yield (device,), {reading.name: reading for reading in group}

    def _topic_of(self, last: Last) -> str:
        newest = next(reversed(last.values()))
        return self._topic.of(newest.labels, device=newest.device, name=newest.name)

    def _messages(self, topic: str, readings: Sequence[Reading]) -> Iterator[Message]:
        if self._is_of_points:
            payloads = (object_text(reading).encode() for reading in readings)
        else:
            payloads = (data for _, data in poll_messages(readings, self._largest))
        for payload in payloads:
            yield Message(topic, payload, self._qos, self._retain)


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
        for reading in readings:
            points = self._answered.setdefault(reading.device, set())
            if reading.quality in ("good", "bad"):
                points.add(reading.name)
            else:
                points.discard(reading.name)
            topic = self._topic.of(reading.labels, device=reading.device)
            states[reading.device] = topic, bool(points)
        return {name: state for name, state in states.items() if self.published.get(name) != state}

    def messages(self, states: Mapping[str, State]) -> Iterator[Message]:
        """Yield the messages with states; a device whose labels have changed has two topics."""
        for name, (topic, answers) in states.items():
            former, _ = self.published.get(name, (topic, False))
            if former != topic:
                yield Message(former, OFFLINE)
            yield Message(topic, ONLINE if answers else OFFLINE)

    def keep_states(self, states: dict[str, State], readings: Sequence[Reading]) -> None:
        """Keep states that were published, and forget devices that are not polled any more."""
        self.published |= states
        for reading in readings:
            if reading.quality == "offline" and not self._answered.get(reading.device):
                self._answered.pop(reading.device, None)
                self.published.pop(reading.device, None)
