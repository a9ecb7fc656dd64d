"""A connection to an MQTT broker. It needs aiomqtt (the extra ``mqtt``)."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import socket
import ssl
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, NamedTuple

from ....protocol.logs import HarmlessLogger
from ....version import what_is_missing
from ...other_servers import SecretFile, ServerUrl, Trust, text_of
from ...tasks import KeptTasks, end_tasks, finish
from .output import OutputError

if TYPE_CHECKING:
    from collections.abc import Coroutine

    import aiomqtt

    OnMessage = Callable[[aiomqtt.Message], Coroutine[Any, Any, None]]

# Seconds for a response of the broker.
TIMEOUT_S = 5.0

# Seconds for the broker to confirm a batch: a slow line takes that long to carry it.
LONGEST_CONFIRMING_S = 60.0

# Seconds without a message after which a ping is sent.
KEEPALIVE_S = 30

# Else each message whose confirmation is waited for would wait for an ACK of TCP, 40 ms.
NO_DELAY = (socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

# Publishes that are sent together, and with QoS 1 wait for their acknowledgement. A broker whose
# sockets delay small packets acknowledges the second and later ones of them 40 ms late.
TOGETHER = 100

# The most received messages that wait; paho drops further ones.
MOST_MESSAGES = 100


class Message(NamedTuple):
    """A payload for a topic; with QoS 1 the broker acknowledges it."""

    topic: str
    payload: bytes
    qos: int = 1
    retain: bool = True


@dataclass
class MqttConnection:
    """
    A connection to a broker, which is opened again after each failure. The broker publishes `will`
    when it is lost. `unused` is a topic filter to which it never subscribes.

    All methods raise ConnectionError if the connection is lost, or the broker refuses something.
    """

    server: ServerUrl
    user: str | None
    password: str | SecretFile | None
    ca: str | None
    client_id: str | None
    will: Message | None
    unused: str

    def __post_init__(self) -> None:
        is_secure = self.server.scheme == "mqtts"
        self._trust = Trust(self.ca, _Handshaking) if is_secure else None
        self._client: aiomqtt.Client | None = None
        self._listening: asyncio.Task[None] | None = None
        # In tasks, because a cancellation may get lost in a call of aiomqtt.
        self._tasks = KeptTasks()

    async def open(self, on_message: OnMessage) -> None:
        """Connect, and call `on_message` in a task of its own for each message that is received."""
        try:
            import aiomqtt
        except ImportError:
            raise OutputError(what_is_missing("MQTT", "mqtt")) from None
        client = aiomqtt.Client(
            self.server.host,
            self.server.port,
            username=self.user,
            password=await text_of(self.password),
            identifier=self.client_id,
            will=aiomqtt.Will(*self.will) if self.will else None,
            timeout=TIMEOUT_S,
            keepalive=KEEPALIVE_S,
            max_inflight_messages=TOGETHER,
            tls_context=await self._trust.context() if self._trust else None,
            max_queued_incoming_messages=MOST_MESSAGES,
            logger=_Debugging(f"{__name__}.client"),  # type: ignore[arg-type]
            socket_options=[NO_DELAY],
        )
        client.pending_calls_threshold = TOGETHER  # it warns of more
        with _as_connection_error():
            try:
                await client.__aenter__()
            except BaseException:
                if client._client.socket() is not None:  # aiomqtt 2.5 leaves it open
                    client._client._sock_close()
                raise
        self._client = client
        self._listening = self._tasks.begin(self._listen(client, on_message))

    async def _listen(self, client: aiomqtt.Client, on_message: OnMessage) -> None:
        with contextlib.suppress(OSError), _as_connection_error():
            async for message in client.messages:
                self._tasks.begin(_call(on_message, message))

    @property
    def _used(self) -> aiomqtt.Client:
        if self._client is None:
            raise ConnectionResetError("the connection was lost")
        return self._client

    async def publish(self, message: Message) -> None:
        """Publish a message; return when the broker has acknowledged it, with QoS 1."""
        with _as_connection_error():
            await self._used.publish(*message)

    async def publish_all(self, messages: Iterator[Message]) -> None:
        """Publish; return when the broker has all, also with QoS 0."""
        assert self._listening is not None
        task = self._tasks.begin(self._publish_all(messages))
        try:
            await asyncio.wait([self._listening, task], return_when=asyncio.FIRST_COMPLETED)
        finally:
            task.cancel()
        if not task.done() or self._listening.done():
            raise ConnectionResetError("the connection was lost")
        task.result()

    async def _publish_all(self, messages: Iterator[Message]) -> None:
        client, is_acknowledged = self._used, True
        with _as_connection_error():
            while together := list(islice(messages, TOGETHER)):
                is_acknowledged = is_acknowledged and all(message.qos for message in together)
                publishing = [client.publish(*message) for message in together]
                for outcome in await asyncio.gather(*publishing, return_exceptions=True):
                    if isinstance(outcome, BaseException):
                        raise outcome
            if not is_acknowledged:
                # The broker acknowledges no publish, but this, which comes behind them, and
                # changes nothing: a connection that it ended because of one of them is noticed.
                await client.unsubscribe(self.unused, timeout=LONGEST_CONFIRMING_S)

    async def subscribe(self, topics: str, qos: int = 1) -> None:
        with _as_connection_error():
            await self._used.subscribe(topics, qos)

    async def read_retained(self, topics: str, on_topic: Callable[[str], None]) -> None:
        """Call `on_topic` with each topic of a filter that has a retained message, however many."""

        def receive(_client: object, _userdata: object, message: Any) -> None:
            if message.retain:
                on_topic(message.topic)

        # Not through aiomqtt, in which they would wait with commands, and push these out; with QoS
        # 0, because mosquitto drops those that wait for acknowledgements beyond a thousand.
        self._used._client.message_callback_add(topics, receive)
        await self.subscribe(topics, 0)
        with _as_connection_error():
            await self._used.unsubscribe(self.unused)  # whose response comes behind them

    async def close(self, last: Message | None) -> None:
        """Publish a last message, if there is one, and disconnect."""
        client, self._client = self._client, None
        await end_tasks([*self._tasks])
        self._listening = None
        if client is None:
            return
        if last is not None:
            await finish(client.publish(*last))
        with contextlib.suppress(OSError), _as_connection_error():
            await client.__aexit__(None, None, None)


async def _call(on_message: OnMessage, message: aiomqtt.Message) -> None:
    with contextlib.suppress(ConnectionError):
        await on_message(message)


class _Debugging(HarmlessLogger):
    """The log of the client: what ends a connection is reported by who opens the next one."""

    def log(self, level: int, msg: object, *args: object, **options: Any) -> None:
        options["stacklevel"] = options.get("stacklevel", 1) + 1
        super().log(logging.DEBUG, msg, *args, **options)


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
    import aiomqtt

    try:
        yield
    except aiomqtt.MqttError as error:
        raise ConnectionError(re.sub(r"^\[code:\d+\] ", "", str(error))) from None
