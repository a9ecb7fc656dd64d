"""Key-value buckets and streams of JetStream: create, check, watch and conditionally write them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from ..tasks import finish
from .connection import EngineError, engine_errors

if TYPE_CHECKING:
    from nats.aio.client import Client
    from nats.aio.msg import Msg
    from nats.js import JetStreamContext
    from nats.js.kv import KeyValue

FORGOTTEN = 30.0  # seconds after which the server forgets a consumer whose client is gone
TIMEOUT = 2.0  # seconds before a request to the server times out
NOT_IN_A_CLUSTER = 10074  # the code with which a single server refuses several replicas


class Change(NamedTuple):
    """A change of a key: its new value, or None if it was deleted, and the revision."""

    key: str
    value: bytes | None
    revision: int


class Bucket:
    """A key-value bucket of NATS, as `open_bucket` returns it."""

    def __init__(self, js: JetStreamContext, keys: KeyValue, name: str) -> None:
        self._js = js
        self.name: str = name
        self._keys = keys

    async def put(self, key: str, value: bytes | None, last: int) -> int:
        """
        Write a value, or delete a key, if the key still has the revision `last`: 0 for a key that
        must not exist. Return 0 if it does not; else the new revision, or 1 for a deletion.
        After an EngineError, the value may have been written.
        """
        import nats.js.errors as js

        with engine_errors(self.name):
            try:
                if value is None:
                    await self._keys.delete(key, last)
                    return 1
                return await self._keys.update(key, value, last)
            except js.KeyWrongLastSequenceError:
                return 0
            except js.BadRequestError as error:
                # A deletion reports a wrong revision as a bad request.
                if error.err_code not in (10071, 10164):
                    raise
        return 0

    async def watch(
        self, on_change: Callable[[Change | None], None], on_gap: Callable[[], None] = lambda: None
    ) -> Watch:
        """
        Call `on_change` with the current value of each key, then with None, then with each change,
        until one was missed: then call `on_gap`.
        """
        watch = Watch(self.name, on_change, on_gap)
        try:
            with engine_errors(self.name):
                await watch.begin(self._js)
        except BaseException:
            await watch.end()
            raise
        return watch


class Watch:
    """
    Reports the changes of a bucket in order, until one was missed; see `Bucket.watch`.

    The contents are complete when every key has come that the leader had after the watch began.
    The number of pending changes is no guide: the server that sends them may lag behind the
    leader, and nats-server 2.9 also counts changes that were replaced before they were sent.
    """

    def __init__(
        self, name: str, on_change: Callable[[Change | None], None], on_gap: Callable[[], None]
    ) -> None:
        self.is_broken: bool = False
        self._prefix = f"$KV.{name}."
        self._stream = f"KV_{name}"
        self._on_change = on_change
        self._on_gap = on_gap
        self._last = 0
        # The subjects of changes that came; and, once they are known, those that must come first.
        self._come: set[str] = set()
        self._missing: set[str] | None = None
        self._is_complete = False
        self._subscription: JetStreamContext.PushSubscription | None = None

    async def begin(self, js: JetStreamContext) -> None:
        from nats.js import api

        # No ordered consumer of nats-py: it repairs gaps silently, but workers must know of them.
        config = api.ConsumerConfig(
            deliver_policy=api.DeliverPolicy.LAST_PER_SUBJECT,
            ack_policy=api.AckPolicy.NONE,
            inactive_threshold=FORGOTTEN,
            mem_storage=True,
            num_replicas=1,
        )
        self._subscription = await js.subscribe(
            f"{self._prefix}>", stream=self._stream, config=config, cb=self._receive
        )
        stream = await js.stream_info(self._stream, f"{self._prefix}>")
        self._missing = set(stream.state.subjects or ()) - self._come
        self._end_contents()

    async def _receive(self, message: Msg) -> None:
        if self.is_broken:
            return
        at = message.metadata
        if at.sequence.consumer != self._last + 1:
            self.is_broken = True
            self._on_gap()
            return
        self._last = at.sequence.consumer
        operation = (message.headers or {}).get("KV-Operation")
        value = None if operation in ("DEL", "PURGE") else message.data
        self._on_change(Change(message.subject[len(self._prefix) :], value, at.sequence.stream))
        if self._missing is None:
            self._come.add(message.subject)
        elif not self._is_complete:
            self._missing.discard(message.subject)
            self._end_contents()

    def _end_contents(self) -> None:
        if not (self._missing or self._is_complete or self.is_broken):
            self._is_complete = True
            self._come.clear()
            self._on_change(None)

    async def end(self) -> None:
        self.is_broken = True
        if self._subscription is not None:
            await finish(self._subscription.unsubscribe(), TIMEOUT)
            # nats-py does not cancel these tasks if the connection is closed already.
            watching: Any = getattr(self._subscription._sub, "_jsi", None)
            for task in (getattr(watching, "_hbtask", None), getattr(watching, "_fctask", None)):
                if task is not None:
                    task.cancel()


async def open_bucket(client: Client, name: str, *, create: bool = False) -> Bucket:
    """Return a bucket; create it if it does not exist, or raise NothingThere."""
    import nats.js.errors as js_errors
    from nats.js import api

    js = client.jetstream(timeout=TIMEOUT)
    with engine_errors(name):
        await js.account_info()
        try:
            keys = await js.key_value(name)
        except js_errors.BucketNotFoundError:
            if not create:
                raise
            config = api.KeyValueConfig(name, history=1, storage=api.StorageType.FILE)
            await _replicated(
                lambda replicas: js.create_key_value(config.evolve(replicas=replicas))
            )
            keys = await js.key_value(name)
        former = (await keys.status()).stream_info.config
    history, age = former.max_msgs_per_subject, former.max_age or 0
    if (history, age) != (1, 0):
        wrong = f"history {history}, not 1, or time to live {age}, not 0"
        raise EngineError(f"bucket {name} has unexpected settings: {wrong}")
    return Bucket(js, keys, name)


async def keep_stream(client: Client, name: str, subjects: str, limits: dict[str, Any]) -> None:
    """
    Create a stream that drops the oldest messages beyond its limits, or change its limits, which
    are options of nats-py's `StreamConfig`, such as max_age in seconds and max_bytes.
    """
    import nats.js.errors as js_errors
    from nats.js import api

    js = client.jetstream(timeout=TIMEOUT)
    config = api.StreamConfig(
        name,
        subjects=[subjects],
        discard=api.DiscardPolicy.OLD,
        storage=api.StorageType.FILE,
        **limits,
    )
    with engine_errors(name):
        try:
            former = (await js.stream_info(name)).config
        except js_errors.NotFoundError:
            await _replicated(lambda replicas: js.add_stream(config.evolve(num_replicas=replicas)))
            return
        if any(getattr(former, key) != value for key, value in limits.items()):
            await js.update_stream(former.evolve(**limits))


async def _replicated(make: Callable[[int], Any]) -> None:
    """Make what three servers store; or the only one, which refuses more."""
    import nats.js.errors as js_errors

    try:
        await make(3)
    except js_errors.APIError as error:
        if error.err_code != NOT_IN_A_CLUSTER:
            raise
        await make(1)
