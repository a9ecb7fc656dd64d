"""
A NATS server with JetStream in memory, on simulated time: one key-value bucket, one stream, and
messages between clients.

What the workers use of nats-py has its face here, so that `Bucket`, `Watch`, `Stream` and
`CommandService` run as they are. Whatever goes to the server or comes from it takes time, and can
be lost; connections break or stand still; the server can stop and can forget.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from collections import deque
from collections.abc import Awaitable, Callable, Iterable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import nats.errors
import nats.js.errors as js_errors
from nats.js import api

from libmodbus_py.services.engine.buckets import Bucket, Change
from libmodbus_py.services.engine.connection import PAUSE, TIMEOUT
from libmodbus_py.services.workers.records import BUCKET

from .network import Network

__all__ = ["Engine", "EngineClient", "Message"]

# Seconds that a message takes each way: the least and the most.
DELAY = (0.0002, 0.002)

# Seconds without an answer after which a client takes its connection for lost: two pings.
UNHEARD = (TIMEOUT, 2 * TIMEOUT)

# How far the server can go back, in seconds; and how many messages its stream keeps.
REMEMBERED = 600.0
MOST_KEPT = 10_000

# As JetStream numbers its errors.
WRONG_LAST = 10071

Reply = Callable[[object], None]


@dataclass
class Message:
    """A message as nats-py hands it over."""

    subject: str
    data: bytes
    reply: str = ""
    headers: dict[str, str] | None = None
    metadata: Any = None


@dataclass
class _Consumer:
    """What the server keeps of somebody who watches the bucket."""

    link: _Link
    subscription: Subscription
    sequence: int = 0
    position: int = 0


class _Undo(NamedTuple):
    """What a key was before it changed."""

    at: float
    key: str
    before: Change | None
    revision: int


class Engine:
    """The server; make it before the loop of its network."""

    def __init__(self, network: Network, delay: tuple[float, float] = DELAY) -> None:
        self.delay: tuple[float, float] = delay
        self.losses: float = 0.0  # probability, of requests, answers and watched changes
        self.latest: dict[str, Change] | None = {}  # None while there is no bucket
        self.revision: int = 0
        self.stream: deque[tuple[float, str, bytes]] = deque(maxlen=MOST_KEPT)
        self.requests: int = 0
        self.is_up: bool = True
        self.processes: Iterator[int] = itertools.count(1)
        network.has_processes = True
        self.events = network.events
        self.descriptors = network.descriptors
        self._config: api.StreamConfig | None = None
        self._known_messages: dict[str, None] = {}
        self._history: deque[_Undo] = deque()
        self._links: list[_Link] = []
        self._consumers: list[_Consumer] = []
        self._subscribers: list[tuple[_Link, str, Subscription]] = []

    # --- for tests --------------------------------------------------------------------------------

    def client(self, on_change: Callable[[], None] = lambda: None) -> EngineClient:
        """Return a connected client, in the running event loop."""
        client = EngineClient(self, on_change)
        self._links.append(client.link)
        return client

    def bucket(self, client: EngineClient) -> Bucket:
        """Return the bucket of the fleet as the package has it."""
        return cast(Any, Bucket)(client, client.jetstream(), _Keys(client), BUCKET)

    def stop(self) -> None:
        """Stop the server: all connections break, and nobody can connect."""
        self.is_up = False
        self._consumers.clear()  # they are in its memory only
        for link in self._links:
            link.break_off()

    def start(self) -> None:
        """Start the server again."""
        self.is_up = True

    def cut(self, client: EngineClient) -> None:
        """Hold back everything that is sent to a client, or by it."""
        client.link.cut()

    def mend(self, client: EngineClient) -> None:
        """Undo `cut`: what was on its way arrives, unless the client has given up."""
        client.link.mend()

    def break_off(self, client: EngineClient) -> None:
        """Break the connection of a client; it connects again."""
        client.link.break_off()

    def forget(self, seconds: float = math.inf) -> None:
        """Let the server lose the changes of the last seconds, as one without its disk does."""
        since = self.events.now - seconds
        while self._history and self._history[-1].at >= since:
            undo = self._history.pop()
            if self.latest is not None:
                if undo.before is None:
                    self.latest.pop(undo.key, None)
                else:
                    self.latest[undo.key] = undo.before
            self.revision = undo.revision
        self.stop()
        self.start()

    def delete_bucket(self) -> None:
        """Delete the bucket: nobody who watches is told."""
        self.latest = None
        self.revision = 0
        self._history.clear()
        self._consumers.clear()

    def create_bucket(self) -> None:
        if self.latest is None:
            self.latest = {}

    def write(self, key: str, value: bytes | None) -> int:
        """Change a key on the server itself; return the revision."""
        assert self.latest is not None
        self._history.append(
            _Undo(self.events.now, key, self.latest.get(key), self.revision),
        )
        while self._history[0].at < self.events.now - REMEMBERED:
            self._history.popleft()
        self.revision += 1
        self.latest[key] = Change(key, value, self.revision)
        for consumer in self._consumers:
            if consumer.position == self.revision - 1 and consumer.link.is_up:
                self._tell(consumer, self.latest[key], 0)
            else:
                self._feed(consumer)
        return self.revision

    def purge(self, *keys: str) -> None:
        """Take keys out of the bucket without a word."""
        for key in keys:
            (self.latest or {}).pop(key, None)

    # --- what clients ask of it -----------------------------------------------------------------

    def loses(self) -> bool:
        """Decide whether JetStream loses a message."""
        return bool(self.losses) and self.events.random.random() < self.losses

    def put(self, reply: Reply, key: str, value: bytes | None, last: int) -> None:
        if self.latest is None:
            reply(js_errors.NoStreamResponseError())
            return
        known = self.latest.get(key)
        if (known.revision if known else 0) == last:
            reply(self.write(key, value))
        elif value is None:
            reply(_bad_request("wrong last sequence"))
        else:
            reply(js_errors.KeyWrongLastSequenceError("nats: wrong last sequence"))

    def status(self, reply: Reply) -> None:
        if self.latest is None:
            reply(js_errors.BucketNotFoundError())
        else:
            config = api.StreamConfig(max_msgs_per_subject=1, max_age=0)
            reply(SimpleNamespace(stream_info=SimpleNamespace(config=config)))

    def create(self, reply: Reply) -> None:
        self.create_bucket()
        reply(None)

    def begin_consumer(self, reply: Reply, link: _Link, subscription: Subscription) -> None:
        if self.latest is None:
            reply(js_errors.NotFoundError(code=404, err_code=10059, description="no stream"))
            return
        consumer = _Consumer(link, subscription)
        self._consumers = [each for each in self._consumers if not each.subscription.is_over]
        self._consumers.append(consumer)
        # Which of the two is first is not promised.
        if self.events.random.random() < 0.5:
            reply(None)
            self._feed(consumer)
        else:
            self._feed(consumer)
            reply(None)

    def consumer_info(self, reply: Reply, subscription: Subscription) -> None:
        for consumer in self._consumers:
            if consumer.subscription is subscription:
                delivered = SimpleNamespace(consumer_seq=consumer.sequence)
                pending = len(self._unread(consumer))
                reply(SimpleNamespace(num_pending=pending, delivered=delivered))
                return
        reply(js_errors.NotFoundError(code=404, err_code=10014, description="no consumer"))

    def end_consumer(self, reply: Reply, subscription: Subscription) -> None:
        self._consumers = [each for each in self._consumers if each.subscription != subscription]
        reply(None)

    def stream_info(self, reply: Reply) -> None:
        if self._config is None:
            reply(js_errors.NotFoundError(code=404, err_code=10059, description="no stream"))
        else:
            reply(SimpleNamespace(config=self._config))

    def configure_stream(self, reply: Reply, config: api.StreamConfig) -> None:
        if (config.num_replicas or 1) > 1:
            refused = js_errors.ServerError(code=500, err_code=10074, description="not clustered")
            reply(refused)
            return
        self._config = config
        reply(None)

    def keep(self, reply: Reply, subject: str, data: bytes, number: str) -> None:
        """Take a message into the stream, unless it is there already."""
        if self._config is None:
            reply(js_errors.NoStreamResponseError())
            return
        if number not in self._known_messages:
            self._known_messages[number] = None
            if len(self._known_messages) > MOST_KEPT:
                del self._known_messages[next(iter(self._known_messages))]
            self.stream.append((self.events.now, subject, data))
            self.publish(Message(subject, data))
        reply(SimpleNamespace(stream="stream"))

    def subscribe(self, link: _Link, pattern: str, subscription: Subscription) -> None:
        self._subscribers.append((link, pattern, subscription))

    def unsubscribe(self, subscription: Subscription) -> None:
        self._subscribers = [each for each in self._subscribers if each[2] is not subscription]

    def publish(self, message: Message) -> None:
        """Hand a message to whoever has subscribed to its subject."""
        for link, pattern, subscription in self._subscribers:
            if _matches(pattern, message.subject):
                link.down(subscription.put, message)

    # --- connections ----------------------------------------------------------------------------

    def connection_lost(self, link: _Link) -> None:
        """Forget what a client subscribed to; its consumers wait for it for a while."""
        self._subscribers = [each for each in self._subscribers if each[0] is not link]

    def connected_again(self, link: _Link) -> None:
        # What its client gave up while it was away is of interest to nobody.
        self._consumers = [each for each in self._consumers if not each.subscription.is_over]
        for consumer in self._consumers:
            if consumer.link is link:
                self._feed(consumer)

    def disconnect(self, link: _Link) -> None:
        self.connection_lost(link)
        self._consumers = [each for each in self._consumers if each.link is not link]
        if link in self._links:
            self._links.remove(link)

    def _unread(self, consumer: _Consumer) -> list[Change]:
        changes = [each for each in self._entries if each.revision > consumer.position]
        return sorted(changes, key=lambda each: each.revision)

    @property
    def _entries(self) -> Iterable[Change]:
        return (self.latest or {}).values()

    def _feed(self, consumer: _Consumer) -> None:
        """Send somebody who watches what has not been sent yet."""
        if consumer.link.is_up:
            entries = self._unread(consumer)
            for at, entry in enumerate(entries, 1):
                self._tell(consumer, entry, len(entries) - at)

    def _tell(self, consumer: _Consumer, entry: Change, left: int) -> None:
        consumer.sequence += 1
        consumer.position = entry.revision
        if self.loses():
            return
        sequence = SimpleNamespace(consumer=consumer.sequence, stream=entry.revision)
        message = Message(
            f"$KV.{BUCKET}.{entry.key}",
            entry.value or b"",
            headers={"KV-Operation": "DEL"} if entry.value is None else None,
            metadata=SimpleNamespace(sequence=sequence, num_pending=left),
        )
        consumer.link.down(consumer.subscription.put, message)


def _bad_request(text: str) -> Exception:
    return js_errors.BadRequestError(code=400, err_code=WRONG_LAST, description=text)


def _matches(pattern: str, subject: str) -> bool:
    wanted, given = pattern.split("."), subject.split(".")
    if wanted[-1] == ">":
        wanted, given = wanted[:-1], given[: len(wanted) - 1]
    return len(wanted) == len(given) and all(
        one in ("*", other) for one, other in zip(wanted, given, strict=True)
    )


_Way = deque[tuple[float, Callable[..., None], tuple[Any, ...]]]
"""One direction of a connection: what goes in comes out later, in order."""


class _Link:
    """The connection of a client."""

    def __init__(self, engine: Engine, client: EngineClient) -> None:
        self.is_cut: bool = False
        self.is_up: bool = True
        self.delay: tuple[float, float] | None = None
        self._engine = engine
        self._client = client
        self._up: _Way = deque()
        self._down: _Way = deque()
        self._cuts = 0

    def up(self, call: Callable[..., None], *args: Any) -> None:
        """Call a function of the server, when the message has arrived there."""
        self._send(self._up, call, args)

    def down(self, call: Callable[..., None], *args: Any) -> None:
        """Call a function of the client, when the message has arrived there."""
        self._send(self._down, self._client.receive, (call, *args))

    def _send(self, way: _Way, call: Callable[..., None], args: tuple[Any, ...]) -> None:
        if not self.is_up:
            return
        events = self._engine.events
        at = events.now + events.random.uniform(*(self.delay or self._engine.delay))
        if way:
            at = max(at, way[-1][0])
        way.append((at, call, args))
        events.at(at, self._arrive, way)

    def _arrive(self, way: _Way) -> None:
        while way and way[0][0] <= self._engine.events.now and not self.is_cut:
            _, call, args = way.popleft()
            call(*args)

    def cut(self) -> None:
        """Hold back everything; the client notices after its pings that nothing arrives."""
        self.is_cut = True
        self._cuts += 1
        events = self._engine.events
        events.after(events.random.uniform(*UNHEARD), self._notice, self._cuts)

    def _notice(self, cut: int) -> None:
        if self.is_cut and self._cuts == cut:
            self.break_off()

    def mend(self) -> None:
        """Undo `cut`."""
        self.is_cut = False
        for way in (self._up, self._down):
            self._arrive(way)

    def break_off(self) -> None:
        """End the connection; what was on its way is lost."""
        if not self.is_up:
            return
        self.is_up = False
        self._up.clear()
        self._down.clear()
        self._engine.connection_lost(self)
        self._client.receive(self._client.connection_lost)
        self._engine.events.after(PAUSE, self._try_again)

    def _try_again(self) -> None:
        if self._client.is_closed:
            return
        if self.is_cut or not self._engine.is_up:
            self._engine.events.after(PAUSE, self._try_again)
            return
        self.is_up = True
        self._client.receive(self._client.connected_again)


class EngineClient:
    """A client, with as much of the face of nats-py's as the package uses."""

    def __init__(self, engine: Engine, on_change: Callable[[], None]) -> None:
        self.on_change: Callable[[], None] = on_change
        self.is_connected: bool = True
        self.is_closed: bool = False
        self.max_payload: int = 1 << 20
        self.engine = engine
        self.link = _Link(engine, self)
        self._loop = asyncio.get_running_loop()
        self._subscriptions: dict[Subscription, str] = {}
        self._inboxes = itertools.count()
        # What has come is taken in the event loop, which this descriptor wakes.
        self._inbox: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._descriptor = engine.descriptors.new()
        self._loop.add_reader(self._descriptor, self._take)

    async def close(self) -> None:
        """Close the connection, and end all subscriptions."""
        self.drop()
        for subscription in list(self._subscriptions):
            await subscription.end()

    def drop(self) -> None:
        """Close the connection as the system does when a process ends."""
        if not self.is_closed:
            self.is_closed, self.is_connected = True, False
            self.link.is_up = False
            self.engine.disconnect(self.link)
            self._loop.remove_reader(self._descriptor)
            self.engine.descriptors.forget(self._descriptor)

    # --- as nats-py's ---------------------------------------------------------------------------

    def jetstream(self, timeout: float = 5.0) -> JetStream:
        return JetStream(self, timeout)

    async def publish(self, subject: str, payload: bytes = b"", reply: str = "") -> None:
        self._check()
        self.link.up(self.engine.publish, Message(subject, payload, reply))

    async def subscribe(
        self, subject: str, cb: Callable[[Any], Awaitable[None]] | None = None
    ) -> Subscription:
        self._check()
        subscription = Subscription(self, cb)
        self._subscriptions[subscription] = subject
        self.link.up(self.engine.subscribe, self.link, subject, subscription)
        return subscription

    async def request(self, subject: str, payload: bytes = b"", timeout: float = 0.5) -> Message:
        answer: asyncio.Future[Message] = self._loop.create_future()

        async def note(message: Message) -> None:
            if not answer.done():
                answer.set_result(message)

        inbox = f"_INBOX.{id(self)}.{next(self._inboxes)}"
        subscription = await self.subscribe(inbox, note)
        try:
            await self.publish(subject, payload, inbox)
            return await asyncio.wait_for(answer, timeout)
        except TimeoutError:
            raise nats.errors.TimeoutError from None
        finally:
            await subscription.unsubscribe()

    # --- below ------------------------------------------------------------------------------

    async def ask(self, timeout: float, request: Callable[..., None], *args: Any) -> Any:
        """Call a function of the server, and wait for its answer."""
        self._check()
        answer = self.begin_to_ask(request, *args)
        try:
            return await asyncio.wait_for(answer, timeout)
        except TimeoutError:
            raise nats.errors.TimeoutError from None

    def begin_to_ask(self, request: Callable[..., None], *args: Any) -> asyncio.Future[Any]:
        answer: asyncio.Future[Any] = self._loop.create_future()

        def reply(result: object) -> None:
            if not self.engine.loses():
                self.link.down(_settle, answer, result)

        def carry_out() -> None:
            if not self.engine.loses():
                self.engine.requests += 1
                request(reply, *args)

        self.link.up(carry_out)
        return answer

    def begin(self, subscription: Subscription) -> None:
        self._subscriptions[subscription] = ""

    def forget(self, subscription: Subscription) -> None:
        self._subscriptions.pop(subscription, None)

    def receive(self, call: Callable[..., None], *args: Any) -> None:
        """Take something from the network; it is done in the event loop."""
        if not self.is_closed:
            self._inbox.append((call, args))
            self.engine.descriptors.readable.add(self._descriptor)

    def _take(self) -> None:
        self.engine.descriptors.readable.discard(self._descriptor)
        while self._inbox:
            call, args = self._inbox.popleft()
            call(*args)

    def _check(self) -> None:
        if self.is_closed:
            raise nats.errors.ConnectionClosedError
        if not self.is_connected:
            raise nats.errors.OutboundBufferLimitError

    def connection_lost(self) -> None:
        self.is_connected = False
        self.on_change()

    def connected_again(self) -> None:
        self.is_connected = True
        for subscription, subject in self._subscriptions.items():
            if subject:
                self.link.up(self.engine.subscribe, self.link, subject, subscription)
        self.link.up(self.engine.connected_again, self.link)
        self.on_change()


def _settle(answer: asyncio.Future[Any], result: object) -> None:
    if answer.done():
        return
    if isinstance(result, Exception):
        answer.set_exception(result)
    else:
        answer.set_result(result)


class Subscription:
    """What a client subscribed to: messages wait here for a task that hands them over."""

    # As nats-py's subscriptions to streams have it, whose tasks this one does without.
    _sub = None

    def __init__(self, client: EngineClient, cb: Callable[[Any], Awaitable[None]] | None) -> None:
        self._client = client
        self._messages: asyncio.Queue[Message] = asyncio.Queue()
        self.is_over = False
        self._task = asyncio.create_task(self._hand_over(cb)) if cb is not None else None

    def put(self, message: Message) -> None:
        if not self.is_over:
            self._messages.put_nowait(message)

    async def next_msg(self, timeout: float = 1.0) -> Message:
        return await asyncio.wait_for(self._messages.get(), timeout)

    async def _hand_over(self, cb: Callable[[Any], Awaitable[None]]) -> None:
        while True:
            await cb(await self._messages.get())

    async def consumer_info(self) -> Any:
        engine = self._client.engine
        return await self._client.ask(TIMEOUT, engine.consumer_info, self)

    async def unsubscribe(self) -> None:
        engine = self._client.engine
        self._client.forget(self)
        self._client.link.up(engine.unsubscribe, self)
        self._client.link.up(engine.end_consumer, lambda _: None, self)
        await self.end()

    async def end(self) -> None:
        self.is_over = True
        self._client.forget(self)
        if self._task is not None and self._task is not asyncio.current_task():
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)


class _Keys:
    """The bucket, as nats-py has it."""

    def __init__(self, client: EngineClient, timeout: float = 2.0) -> None:
        self._client = client
        self._timeout = timeout

    async def update(self, key: str, value: bytes, last: int) -> int:
        revision: int = await self._ask(self._client.engine.put, key, value, last)
        return revision

    async def delete(self, key: str, last: int) -> bool:
        return bool(await self._ask(self._client.engine.put, key, None, last))

    async def status(self) -> Any:
        return await self._ask(self._client.engine.status)

    async def _ask(self, request: Callable[..., None], *args: Any) -> Any:
        return await self._client.ask(self._timeout, request, *args)


class JetStream:
    """What the package uses of nats-py's `JetStreamContext`."""

    def __init__(self, client: EngineClient, timeout: float) -> None:
        self._client = client
        self._timeout = timeout
        self._engine = client.engine

    async def _ask(self, request: Callable[..., None], *args: Any) -> Any:
        return await self._client.ask(self._timeout, request, *args)

    async def account_info(self) -> None:
        await self._ask(lambda reply: reply(None))

    async def key_value(self, name: str) -> _Keys:
        await self._ask(self._engine.status)
        return _Keys(self._client, self._timeout)

    async def create_key_value(self, config: Any) -> None:
        await self._ask(self._engine.create)

    async def subscribe(self, subject: str, *, cb: Any, **_: Any) -> Subscription:
        subscription = Subscription(self._client, cb)
        self._client.begin(subscription)
        try:
            await self._ask(self._engine.begin_consumer, self._client.link, subscription)
        except BaseException:
            await subscription.end()
            raise
        return subscription

    async def stream_info(self, name: str) -> Any:
        return await self._ask(self._engine.stream_info)

    async def add_stream(self, config: api.StreamConfig) -> None:
        await self._ask(self._engine.configure_stream, config)

    async def update_stream(self, config: api.StreamConfig) -> None:
        await self._ask(self._engine.configure_stream, config)

    async def publish_async(
        self, subject: str, data: bytes, headers: dict[str, str]
    ) -> asyncio.Future[Any]:
        self._client._check()
        number = headers.get("Nats-Msg-Id", "")
        return self._client.begin_to_ask(self._engine.keep, subject, data, number)
