"""
The clients of the simulated server of NATS, and their connections.

What the workers use of nats-py has its face here, so that `Bucket`, `Watch`, `Stream` and
`CommandService` run as they are.
"""

from __future__ import annotations

import asyncio
import itertools
from collections import deque
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import nats.errors
from nats.js import api

from libmodbus_py.services.engine.connection import PAUSE, TIMEOUT

if TYPE_CHECKING:
    from .engine import Engine

# Seconds without an answer after which a client takes its connection for lost: two pings.
UNHEARD = (TIMEOUT, 2 * TIMEOUT)

_Way = deque[tuple[float, Callable[..., None], tuple[Any, ...]]]
"""One direction of a connection: what goes in comes out later, in order."""


@dataclass
class Message:
    """A message as nats-py hands it over."""

    subject: str
    data: bytes
    reply: str = ""
    headers: dict[str, str] | None = None
    metadata: Any = None


class Link:
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
        self.link = Link(engine, self)
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


class Asking:
    """What asks the server, and waits so many seconds for its answer."""

    def __init__(self, client: EngineClient, timeout: float = 2.0) -> None:
        self._client = client
        self._timeout = timeout
        self._engine = client.engine

    async def _ask(self, request: Callable[..., None], *args: Any) -> Any:
        return await self._client.ask(self._timeout, request, *args)


class Keys(Asking):
    """The bucket, as nats-py has it."""

    async def update(self, key: str, value: bytes, last: int) -> int:
        revision: int = await self._ask(self._engine.put, key, value, last)
        return revision

    async def delete(self, key: str, last: int) -> bool:
        return bool(await self._ask(self._engine.put, key, None, last))

    async def status(self) -> Any:
        return await self._ask(self._engine.status)


class JetStream(Asking):
    """What the package uses of nats-py's `JetStreamContext`."""

    async def account_info(self) -> None:
        await self._ask(lambda reply: reply(None))

    async def key_value(self, name: str) -> Keys:
        await self._ask(self._engine.status)
        return Keys(self._client, self._timeout)

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

    async def stream_info(self, name: str, subjects_filter: str | None = None) -> Any:
        return await self._ask(
            self._engine.stream_info if subjects_filter is None else self._engine.subjects
        )

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
