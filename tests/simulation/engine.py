"""
A NATS server with JetStream in memory, on simulated time: one key-value bucket, one stream, and
messages between clients.

Whatever goes to the server or comes from it takes time, and can be lost; connections break or stand
still; the server can stop and can forget. Its clients are in `engine_client`.
"""

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, NamedTuple, cast

import nats.js.errors as js_errors
from nats.js import api

from libmodbus_py.services.engine.buckets import Bucket, Change
from libmodbus_py.services.workers.records import BUCKET

from .engine_client import EngineClient, Keys, Link, Message, Subscription
from .network import Network
from .runner import runner_of

# Seconds that a message takes each way: the least and the most.
DELAY = (0.0002, 0.002)

# How far the server can go back, in seconds; and how many messages its stream keeps.
REMEMBERED = 600.0
MOST_KEPT = 10_000

# As JetStream numbers its errors.
WRONG_LAST = 10071

Reply = Callable[[object], None]


@dataclass
class _Consumer:
    """What the server keeps of somebody who watches the bucket."""

    link: Link
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
        self.served: float = math.inf  # the newest revision that consumers get: the server lags
        self.stream: deque[tuple[float, str, bytes]] = deque(maxlen=MOST_KEPT)
        self.is_up: bool = True
        self.processes: Iterator[int] = itertools.count(1)
        network.has_processes = True
        self.events = network.events
        self.descriptors = network.descriptors
        self._config: api.StreamConfig | None = None
        self._known_messages: dict[str, None] = {}
        self._history: deque[_Undo] = deque()
        self._links: list[Link] = []
        self._consumers: list[_Consumer] = []
        self._subscribers: list[tuple[Link, str, Subscription]] = []

    # --- for tests --------------------------------------------------------------------------------

    def client(self, on_change: Callable[[], None] = lambda: None) -> EngineClient:
        """Return a connected client, in the running event loop."""
        client = EngineClient(self, on_change)
        self._links.append(client.link)
        return client

    def bucket(self, client: EngineClient) -> Bucket:
        """Return the bucket of the fleet as the package has it."""
        return cast(Any, Bucket)(client.jetstream(), Keys(client), BUCKET)

    def stop(self) -> None:
        """Stop the server: all connections break, and nobody can connect."""
        self.is_up = False
        self._consumers.clear()  # they are in its memory only
        for link in self._links:
            link.break_off()

    def start(self) -> None:
        """Start the server again."""
        self.is_up = True

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
        self._history.append(_Undo(self.events.now, key, self.latest.get(key), self.revision))
        while self._history[0].at < self.events.now - REMEMBERED:
            self._history.popleft()
        self.revision += 1
        self.latest[key] = Change(key, value, self.revision)
        for consumer in self._consumers:
            if consumer.position == self.revision - 1 and consumer.link.is_up:
                self._tell(consumer, self.latest[key])
            else:
                self._feed(consumer)
        return self.revision

    def catch_up(self, to: float = math.inf) -> None:
        """Let consumers get what a server that lagged behind has now."""
        self.served = to
        for consumer in self._consumers:
            self._feed(consumer)

    # --- what clients ask of it -----------------------------------------------------------------

    def loses(self) -> bool:
        """Decide whether JetStream loses a message."""
        return bool(self.losses) and self.events.random.random() < self.losses

    def put(self, reply: Reply, key: str, value: bytes | None, last: int) -> None:
        if self.latest is None:
            reply(js_errors.NoStreamResponseError())
            return
        entry = self.latest.get(key)
        if (entry.revision if entry else 0) == last:
            reply(self.write(key, value))
        elif value is None:
            text = "wrong last sequence"
            reply(js_errors.BadRequestError(code=400, err_code=WRONG_LAST, description=text))
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

    def begin_consumer(self, reply: Reply, link: Link, subscription: Subscription) -> None:
        if self.latest is None:
            reply(js_errors.NotFoundError(code=404, err_code=10059, description="no stream"))
            return
        consumer = _Consumer(link, subscription)
        self._consumers = [item for item in self._consumers if not item.subscription.is_over]
        self._consumers.append(consumer)
        # Which of the two is first is not promised.
        if self.events.random.random() < 0.5:
            reply(None)
            self._feed(consumer)
        else:
            self._feed(consumer)
            reply(None)

    def subjects(self, reply: Reply) -> None:
        """Name the subjects of all keys, those of deleted ones, too."""
        subjects = {f"$KV.{BUCKET}.{key}": 1 for key in self.latest or {}}
        reply(SimpleNamespace(state=SimpleNamespace(subjects=subjects or None)))

    def end_consumer(self, reply: Reply, subscription: Subscription) -> None:
        self._consumers = [item for item in self._consumers if item.subscription != subscription]
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

    def subscribe(self, link: Link, pattern: str, subscription: Subscription) -> None:
        self._subscribers.append((link, pattern, subscription))

    def unsubscribe(self, subscription: Subscription) -> None:
        self._subscribers = [item for item in self._subscribers if item[2] is not subscription]

    def publish(self, message: Message) -> None:
        """Hand a message to whoever has subscribed to its subject."""
        for link, pattern, subscription in self._subscribers:
            if _matches(pattern, message.subject):
                link.down(subscription.put, message)

    # --- connections ----------------------------------------------------------------------------

    def connection_lost(self, link: Link) -> None:
        """Forget what a client subscribed to; its consumers wait for it for a while."""
        self._subscribers = [item for item in self._subscribers if item[0] is not link]

    def connected_again(self, link: Link) -> None:
        # What its client gave up while it was away is of interest to nobody.
        self._consumers = [item for item in self._consumers if not item.subscription.is_over]
        for consumer in self._consumers:
            if consumer.link is link:
                self._feed(consumer)

    def disconnect(self, link: Link) -> None:
        self.connection_lost(link)
        self._consumers = [consumer for consumer in self._consumers if consumer.link is not link]
        if link in self._links:
            self._links.remove(link)

    def _unread(self, consumer: _Consumer) -> list[Change]:
        entries = (self.latest or {}).values()
        changes = [entry for entry in entries if consumer.position < entry.revision <= self.served]
        return sorted(changes, key=lambda each: each.revision)

    def _feed(self, consumer: _Consumer) -> None:
        """Send somebody who watches what has not been sent yet."""
        if consumer.link.is_up:
            for entry in self._unread(consumer):
                self._tell(consumer, entry)

    def _tell(self, consumer: _Consumer, entry: Change) -> None:
        consumer.sequence += 1
        consumer.position = entry.revision
        if self.loses():
            return
        sequence = SimpleNamespace(consumer=consumer.sequence, stream=entry.revision)
        message = Message(
            f"$KV.{BUCKET}.{entry.key}",
            entry.value or b"",
            headers={"KV-Operation": "DEL"} if entry.value is None else None,
            metadata=SimpleNamespace(sequence=sequence),
        )
        consumer.link.down(consumer.subscription.put, message)


def _matches(pattern: str, subject: str) -> bool:
    tokens, levels = pattern.split("."), subject.split(".")
    if tokens[-1] == ">":
        tokens, levels = tokens[:-1], levels[: len(tokens) - 1]
    return len(tokens) == len(levels) and all(
        one in ("*", other) for one, other in zip(tokens, levels, strict=True)
    )


def _run_with_engine(test: Callable[..., Any]) -> None:
    network = Network()
    engine = Engine(network)

    async def main() -> None:
        client = engine.client()
        await test(engine, client)
        await client.close()

    network.run(main)


with_engine = runner_of(_run_with_engine, count=2)
"""Let a test have a server of NATS on simulated time, and a client of it."""
