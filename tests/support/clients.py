"""
Every kind of client behind the same calls, on the real system or on a network in memory.

`connecting` makes clients of one kind on the real system. A `World` makes clients and the peers
that they talk to on a `Network` whose clock jumps, where times are exact.
"""

import asyncio
import contextlib
import inspect
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Self

import pytest

from libmodbus_py import AsyncClient, Client
from tests.simulation.loop import VirtualLoop, complaints_of
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.peers import OnRequest
from tests.support.urls import url_for

KINDS = ["blocking", "asyncio"]  # `Client` and `AsyncClient`

ALL = pytest.mark.parametrize("kind", KINDS)

# A URL and options -> a client, to be used as a `Client` is.
Connect = Callable[..., Any]


def read(client: Any, address: int) -> int:
    """Return the value of one holding register."""
    (value,) = client.read_holding_registers(address, 1)
    assert isinstance(value, int)
    return value


class Awaited:
    """An `AsyncClient` with the calls of a `Client`. `run`: returns what an awaitable returns."""

    def __init__(self, run: Callable[[Any], Any], plc: AsyncClient) -> None:
        vars(self).update(_run=run, _plc=plc)

    def __getattr__(self, name: str) -> Any:
        attribute = getattr(self._plc, name)
        if not inspect.ismethod(attribute) and not inspect.isfunction(attribute):
            return attribute

        def call(*arguments: Any, **options: Any) -> Any:
            result = attribute(*arguments, **options)
            if inspect.iscoroutine(result):
                return self._run(result)
            return result if isinstance(result, list) else Awaited(self._run, result)

        return call

    def __setattr__(self, name: str, value: Any) -> None:
        async def change() -> None:
            setattr(self._plc, name, value)

        self._run(change())

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Any:
        """Return the next value of what is for ``async for``."""
        try:
            return self._run(self._plc.__anext__())
        except StopAsyncIteration:
            raise StopIteration from None

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextmanager
def connecting(kind: str) -> Iterator[Connect]:
    """Yield what makes clients: of one kind."""
    if kind == "asyncio":
        with running_loop() as loop:
            yield lambda url, **options: Awaited(threadsafe(loop), AsyncClient(url, **options))
    else:
        yield Client


@contextmanager
def asking(kind: str, url: str, **options: Any) -> Iterator[Any]:
    """Make one client, connect it, and close it in the end."""
    with connecting(kind) as connect, connect(url, **options) as client:
        yield client


def threadsafe(loop: asyncio.AbstractEventLoop) -> Callable[[Any], Any]:
    """Return what has a coroutine run by the loop of another thread."""

    def run(coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, loop).result(30)

    return run


@contextmanager
def running_loop() -> Iterator[asyncio.AbstractEventLoop]:
    """An event loop in a thread; whatever it complains of fails the test."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    with complaints_of(loop) as complaints:
        thread.start()
        try:
            yield loop
        finally:
            loop.call_soon_threadsafe(loop.stop)
            thread.join()
            tasks = asyncio.all_tasks(loop)
            loop.close()
    assert not complaints
    assert not tasks


class World:
    """
    Clients of one kind, and peers for them, on a network in memory: waiting takes no time, and
    times are exact. `kind`: one of `KINDS`.
    """

    def __init__(self, kind: str, network: Network, loop: VirtualLoop) -> None:
        self.kind = kind
        self.network = network
        self._loop = loop

    def connect(self, url: str, **options: Any) -> Any:
        """Return a client, to be used as a `Client` is."""
        if self.kind == "asyncio":
            return Awaited(self._loop.run_until_complete, AsyncClient(url, **options))
        return Client(url, **options)

    def peer(self, scheme: str, on_request: OnRequest) -> Scripted:
        """Return a peer that runs until the world ends."""
        url = url_for(scheme, line="/dev/line?baudrate=115200")
        return Scripted(self.network, url, on_request)

    def client_of(self, scheme: str, on_request: OnRequest, **options: Any) -> Any:
        """Return a client of a peer that runs until the world ends."""
        return self.connect(self.peer(scheme, on_request).url, **options)

    @property
    def now(self) -> float:
        """The time in seconds."""
        return self.network.events.now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        self._loop.run_until_complete(asyncio.sleep(seconds))

    def compute(self, seconds: float) -> None:
        """Let time pass while the program does other things, and its event loop nothing."""
        until = self.now + seconds
        while self.now < until:
            self.network.events.advance(until)

    @contextmanager
    def lasting(self, seconds: float, more: float = 0.002) -> Iterator[None]:
        """
        Demand that what is done within takes so many seconds. `more`: how much longer it may take:
        the way of a request, and the millisecond that `poll` counts.
        """
        start = self.now
        yield
        # A timer may ring a nanosecond early.
        assert seconds - 1e-6 <= self.now - start <= seconds + more


@contextmanager
def making(kind: str) -> Iterator[World]:
    """Yield a world for clients of a kind."""
    network = Network()
    loop = network.loop()
    with contextlib.closing(loop), network.installed(), complaints_of(loop) as complaints:
        yield World(kind, network, loop)
        tasks = [repr(task.get_coro()) for task in asyncio.all_tasks(loop)]
    assert not complaints, complaints
    assert not tasks, tasks
