"""
An output to an MQTT broker, which also receives writes. It needs aiomqtt (the extra ``mqtt``).
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import socket
import ssl
from collections import Counter
from collections.abc import Callable, Coroutine, Hashable, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

from ....protocol.checks import integer
from ....protocol.logs import HarmlessLogger
from ....protocol.mistakes import WrongType, WrongValue
from ....security.renewed import Renewed
from ...server_url import url_without_login
from ...tasks import end_tasks, finish
from ..buffer import MOST_KEPT
from ..commands import Commands, encoded, wanted_of
from ..config import DeviceConfig
from ..readings import Reading
from .device_states import DeviceStates
from .mqtt_messages import Message, Messages, PointMessages, PollMessages
from .output import OutputError
from .secret_file import SecretFile, text_of
from .topics import Topic, plain_topic
from .trust import trust

if TYPE_CHECKING:
    import aiomqtt

__all__ = ["Mqtt"]

logger: HarmlessLogger = HarmlessLogger(__name__)

ONLINE, OFFLINE = b"online", b"offline"

SCHEMES = {"mqtt": 1883, "mqtts": 8883}

# Seconds for a response of the broker.
TIMEOUT = 5.0

# Seconds for the broker to confirm a batch: a slow line takes that long to carry it.
LONGEST_CONFIRMING = 60.0

# Else each message whose confirmation is waited for would wait for an ACK of TCP, 40 ms.
NO_DELAY = (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

# After so many lost connections in a row, last values are published again one by one; the one at
# which it is lost so many times more is forgotten.
MOST_LOSSES = 3

# Publishes that are sent together, and with QoS 1 wait for their acknowledgement. A broker whose
# sockets delay small packets acknowledges the second and later ones of them 40 ms late.
TOGETHER = 100

LARGEST = 268_435_000
"""The bytes of a message that MQTT can carry, with a long topic."""

# The most received messages that wait; paho drops further ones.
MOST_MESSAGES = 100


class Mqtt:
    """
    Publishes each reading to its own topic, retained, so that a new subscriber receives the last
    values at once: ``{"time": ..., "value": 230.5, "unit": "V", "quality": "good"}``.

    The topic `status` contains "online" while this output is connected, and "offline" otherwise,
    which the broker publishes when the connection is lost (last will). Several workers have one
    status: it is "online" while one of them is connected.

    When the connection is established again, the last values are published again, because a broker
    that was restarted may have lost them.

    Args:
        url: the URL of the broker, such as "mqtt://192.0.2.1" or "mqtts://broker.example:8883"
            (TLS).
        user, password: credentials of the broker; None for none. A `SecretFile` is read again for
            each connection, and on SIGHUP.
        topic: the topic of a reading, with {device} and {name} on different levels, and labels
            of devices such as {label.site}; in all of them, the characters ``/ + # %`` are
            written %2F and so on. Without {name}, each poll of a device is one message:
            ``{"device": ..., "values": {NAME: {...}}}``; if it is retained, it also has the last
            values of the other points of the device.
        status: the topic of the status, which no reading may have; empty for none.
        device_status: the topic with "online" while a device answers, else "offline", with
            {device} and labels; no reading may have it. Empty for none.
        retain: True if the broker keeps the last value of each topic.
        qos: 0, or 1 for readings that the broker must acknowledge.
        ca: a file with the certificate authorities to trust, for mqtts; those of the system
            unless given. It is read again like a `SecretFile`.
        client_id: the client identifier; None to have the broker assign one.
        commands: True to write the values published to `topic` + "/set" to the device; see
            `Commands`. The outcome is published to `topic` + "/set/result". If the topic has no
            {name}, "/{name}" comes before "/set".
        max_message: the most bytes of a message, 1024 or more, if the broker takes no larger
            ones; a larger poll is several messages, with ``"part": 1, "parts": 3``. It needs a
            topic without {name} and `retain` False, because the broker retains one message of a
            topic. None for what MQTT can carry.
        buffer: the most readings that wait for the broker; the oldest are dropped beyond.

    Raises:
        TypeError, ValueError: an argument of the wrong type or range.
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
        self._server = server = url_without_login(url, SCHEMES, "mqtt://192.0.2.1:1883")
        self.name: str = f"mqtt {server.place}"
        self.buffer: int = buffer
        if password is not None and user is None:
            raise WrongValue("user", "must be given with a password")
        for key, flag in (("retain", retain), ("commands", commands)):
            if not isinstance(flag, bool):
                raise WrongType(key, f"must be true or false, not {flag!r}")
        self.exclusive: tuple[str, ...] = (f"the topic {topic!r} of {self.name}",)
        if client_id is not None:  # with which a broker has one connection
            self.exclusive += (f"the client_id {client_id!r} at {self.name}",)
        is_of_points = not isinstance(topic, str) or "{name}" in topic or "{device}" not in topic
        self._topic = Topic("topic", topic, ("device", "name") if is_of_points else ("device",))
        self._point = (
            self._topic if is_of_points else Topic("topic", f"{topic}/{{name}}", ("device", "name"))
        )
        self._status = plain_topic("status", status)
        if self._topic.can_be(self._status):
            raise WrongValue("status", f"must not be the topic of a reading: {status!r}")
        self._device_status = _of_devices(device_status, self._topic, self._point, self._status)
        self._states = DeviceStates()
        self._labels: dict[str, Mapping[str, str]] = {}
        self._retain = retain
        self._messages = self._messages_of(retain, max_message)
        self._qos = integer("qos", qos, 0, 1)
        if ca is not None and server.scheme != "mqtts":
            raise WrongValue("ca", "can only be used with mqtts://")
        self._ca, self._password = ca, password
        self._trusted: Renewed[ssl.SSLContext] | None = None
        self._options = {"username": user, "identifier": client_id}
        self.takes_commands: bool = commands
        self._commands: Commands | None = None
        self._client: aiomqtt.Client | None = None
        # The topics at which the broker retains the states of devices.
        self._state_topics: dict[str, str] = {}
        self._state_labels: dict[str, Mapping[str, str]] = {}
        # Connections in a row that were lost while these were published again; the one that was
        # being published alone; and how often the connection was lost at each.
        self._lost_again = 0
        self._alone: Hashable | None = None
        self._losses: Counter[Hashable] = Counter()
        self._listening: asyncio.Task[None] | None = None
        self._sending: set[asyncio.Task[None]] = set()

    def _messages_of(self, retain: bool, most: int | None) -> Messages:
        """Return the messages of points, or of devices, as the topic says."""
        key, is_of_points = "max_message", self._topic is self._point
        if most is not None:
            integer(key, most, 1024, LARGEST)
            if is_of_points or retain:
                raise WrongValue(key, "needs a topic without {name}, and retain = false")
        if is_of_points:
            return PointMessages(self._topic)
        return PollMessages(self._topic, is_retained=retain, largest=most or LARGEST)

    @property
    def identity(self) -> str:
        """The name of its place in a journal."""
        return f"{self.name} {self._topic.template}"

    def describe(self, devices: Mapping[str, DeviceConfig]) -> None:
        """
        Set the devices of the readings.

        Raises:
            ValueError: a device lacks a label that a topic holds; nothing changes then.
        """
        for topic in filter(None, (self._topic, self._device_status)):
            topic.check(devices)
        self._labels = {name: each.labels for name, each in devices.items()}

    def attach(self, commands: Commands) -> None:
        """Set the object that carries out commands."""
        self._commands = commands

    async def open(self) -> None:
        try:
            import aiomqtt
        except ImportError:
            raise OutputError("MQTT needs aiomqtt: pip install 'libmodbus-py[mqtt]'") from None
        will = aiomqtt.Will(self._status, OFFLINE, 1, True) if self._status else None
        client = aiomqtt.Client(
            self._server.host,
            self._server.port,
            **self._options,  # type: ignore[arg-type]
            password=await asyncio.to_thread(text_of, self._password),
            will=will,
            timeout=TIMEOUT,
            keepalive=30,
            max_inflight_messages=TOGETHER,
            tls_context=await asyncio.to_thread(self._context)
            if self._server.scheme == "mqtts"
            else None,
            max_queued_incoming_messages=MOST_MESSAGES,
            logger=_Debugging(f"{__name__}.client"),  # type: ignore[arg-type]
            socket_options=[NO_DELAY],
        )
        client.pending_calls_threshold = TOGETHER  # it warns of more
        with _as_connection_error():
            try:
                await client.__aenter__()
            except BaseException:
                _let_go(client)
                raise
            self._client = client
            self._listening = asyncio.create_task(self._listen(client))
            if self.takes_commands:  # before "online", at which programs may send commands
                await client.subscribe(f"{self._point.filter}/set", 1)
            if self._status:
                await client.publish(self._status, ONLINE, 1, True)
                await client.subscribe(self._status, 1)
            # The broker may have been restarted, and may have lost what it retained.
            await self._while_connected(self._publish_again(client))

    def _context(self) -> ssl.SSLContext:
        if self._trusted is None:
            self._trusted = Renewed(partial(_trust, self._ca))
            return self._trusted.value
        return self._trusted.fresh()

    async def write(self, readings: Sequence[Reading]) -> None:
        client = self._client
        assert client is not None
        with _as_connection_error():
            await self._while_connected(self._publish_all(client, readings, self._messages.of))
            changed = self._changed_states(readings)
            await self._while_connected(self._publish_states(client, changed))
        self._states.note(changed, readings)
        for name in self._state_topics.keys() - self._states.told.keys():
            del self._state_topics[name], self._state_labels[name]
        if self._retain:
            self._messages.note(readings)

    async def _publish_all(
        self,
        client: aiomqtt.Client,
        readings: Sequence[Reading],
        messages_of: Callable[[Sequence[Reading]], Iterator[Message]],
    ) -> None:
        if self._retain:
            for message in self._messages.left(readings):
                await self._publish(client, message)
        messages = messages_of(readings)
        while together := list(islice(messages, TOGETHER)):
            await _all([self._publish(client, each) for each in together])
        if readings and not self._qos:
            # The broker acknowledges no publish, but this, which comes behind them, and changes
            # nothing: a connection that it ended because of one of them is noticed here.
            await client.unsubscribe(self._topic.filter, timeout=LONGEST_CONFIRMING)

    async def _publish_again(self, client: aiomqtt.Client) -> None:
        """Publish all last values; forget one on which the broker ends the connection."""
        self._forget_refused()
        self._lost_again += 1
        kept, again = self._messages.kept(), self._messages.again
        if self._lost_again <= MOST_LOSSES:
            await self._publish_all(client, [*chain.from_iterable(kept.values())], again)
        else:
            for key, readings in kept.items():
                self._alone = key
                await self._publish_all(client, readings, again)
        self._alone = None
        await self._publish_states(client, self._states.told)
        self._lost_again = 0
        self._losses.clear()

    def _forget_refused(self) -> None:
        key, self._alone = self._alone, None
        # Behind all others, which show whether it is the reason.
        if key is None or not self._messages.put_last(key):
            return
        self._losses[key] += 1
        if self._losses[key] >= MOST_LOSSES:
            told = self._messages.forget(key)
            logger.error("%s: %s is not published again", self.name, told)

    def _changed_states(self, readings: Sequence[Reading]) -> dict[str, bool]:
        """Return the states of devices that are to be published, some of them at another topic."""
        if self._device_status is None:
            return {}
        changed = self._states.changed(readings)
        self._state_labels |= {each.device: each.labels for each in readings}
        for name in {each.device for each in readings} & self._states.told.keys():
            if self._state_topic(name) != self._state_topics.get(name):
                changed.setdefault(name, self._states.told[name])
        return changed

    def _state_topic(self, device: str) -> str:
        assert self._device_status is not None
        return self._device_status.of(self._state_labels.get(device, {}), device=device)

    async def _publish_states(self, client: aiomqtt.Client, states: Mapping[str, bool]) -> None:
        for name, answers in list(states.items()):
            topic = self._state_topic(name)
            former = self._state_topics.get(name, topic)
            if former != topic:  # a label has changed
                await client.publish(former, OFFLINE, 1, True)
            self._state_topics[name] = topic
            await client.publish(topic, ONLINE if answers else OFFLINE, 1, True)

    async def _while_connected(self, publishing: Coroutine[Any, Any, None]) -> None:
        """Wait for messages to be published; raise if the connection is lost before."""
        assert self._listening is not None
        task = self._begin(publishing)
        try:
            await asyncio.wait([self._listening, task], return_when=asyncio.FIRST_COMPLETED)
        finally:
            task.cancel()
        if not task.done() or self._listening.done():
            raise ConnectionResetError("the connection was lost")
        task.result()

    async def _publish(self, client: aiomqtt.Client, message: Message) -> None:
        topic, data = message
        await client.publish(topic, data, self._qos, self._retain)

    async def close(self) -> None:
        client, self._client = self._client, None
        tasks = [*self._sending, *([self._listening] if self._listening else [])]
        await end_tasks(tasks)
        self._listening = None
        if client is None:
            return
        if self._status:
            await finish(client.publish(self._status, OFFLINE, 1, True), 1.0)
        with contextlib.suppress(OSError), _as_connection_error():
            await client.__aexit__(None, None, None)

    # --- commands ---------------------------------------------------------------------------

    async def _listen(self, client: aiomqtt.Client) -> None:
        """Answer commands until the connection is lost."""
        with contextlib.suppress(OSError), _as_connection_error():
            async for message in client.messages:
                if str(message.topic) == self._status:
                    # The last will of another worker, or of an earlier connection of this one.
                    if message.payload == OFFLINE:
                        self._begin(self._contradict(client))
                elif self._commands is not None and not message.retain:  # a retained one is old
                    self._begin(self._answer(client, self._commands, message))

    def _begin(self, sending: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        # In a task, because a cancellation may get lost in a call of aiomqtt.
        task = asyncio.create_task(sending)
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)
        return task

    async def _contradict(self, client: aiomqtt.Client) -> None:
        with contextlib.suppress(OSError), _as_connection_error():
            await client.publish(self._status, ONLINE, 1, True)

    async def _answer(
        self, client: aiomqtt.Client, commands: Commands, message: aiomqtt.Message
    ) -> None:
        topic = str(message.topic)
        asked = topic.removesuffix("/set")
        names = self._point.read(asked)
        data = message.payload if isinstance(message.payload, bytes) else b""
        # A rule of the broker that goes by a label must hold: only the own topic of a point counts.
        if names is None or self._point.of(self._labels.get(names["device"], {}), **names) != asked:
            return
        device, name = names["device"], names["name"]
        outcome = await commands.answer(device, name, wanted_of(data))
        if outcome is None:
            return
        with contextlib.suppress(OSError), _as_connection_error():
            await client.publish(f"{topic}/result", encoded(outcome), self._qos)


class _Debugging(HarmlessLogger):
    """The log of the client: what ends a connection is told by who opens the next one."""

    def log(self, level: int, msg: object, *args: object, **options: Any) -> None:
        options["stacklevel"] = options.get("stacklevel", 1) + 1
        super().log(logging.DEBUG, msg, *args, **options)


def _let_go(client: aiomqtt.Client) -> None:
    """Close the socket of a client that could not connect; aiomqtt 2.5 leaves it open."""
    paho = client._client
    if paho.socket() is not None:
        paho._sock_close()


async def _all(publishing: list[Coroutine[Any, Any, None]]) -> None:
    if len(publishing) == 1:
        await publishing[0]
        return
    for outcome in await asyncio.gather(*publishing, return_exceptions=True):
        if isinstance(outcome, BaseException):
            raise outcome


def _of_devices(template: str, topic: Topic, point: Topic, status: str) -> Topic | None:
    """Return the topic of the states of devices; see `Mqtt`."""
    key = "device_status"
    if not plain_topic(key, template):
        return None
    made = Topic(key, template, ("device",))
    taken = [topic.template, *(f"{point.template}{each}" for each in ("/set", "/set/result"))]
    if any(made.can_be(each) for each in taken):
        raise WrongValue(key, f"must not be the topic of a reading: {template!r}")
    if made.can_be(status):
        raise WrongValue(key, f"must not be the topic of the status: {template!r}")
    return made


def _trust(ca: str | None) -> ssl.SSLContext:
    """Return the context of TLS; raise OSError as `trust`."""
    context = trust(ca)
    context.sslsocket_class = _Handshaking
    return context


class _Handshaking(ssl.SSLSocket):
    """A socket that is closed when its handshake fails; paho leaves it open."""

    def do_handshake(self, block: bool = False) -> None:
        try:
            super().do_handshake(block)
        except BaseException:
            self.close()
            raise


@contextlib.contextmanager
def _as_connection_error() -> Iterator[None]:
    """Raise errors of aiomqtt as ConnectionError."""
    import aiomqtt

    try:
        yield
    except aiomqtt.MqttError as error:
        raise ConnectionError(re.sub(r"^\[code:\d+\] ", "", str(error))) from None
