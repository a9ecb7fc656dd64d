"""
Every kind of client behind the same calls, for tests of what holds for all of them.
"""

from __future__ import annotations

import asyncio
import inspect
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, Self

from libmodbus_py import AsyncClient, Context

KINDS = ["native", "python", "asyncio"]

# A URL and options -> a client, to be used as a `Context` is.
Connect = Callable[..., Any]


@contextmanager
def connecting(kind: str) -> Iterator[Connect]:
    """Give what makes clients: contexts with or without libmodbus, or an AsyncClient."""
    if kind == "asyncio":
        with running_loop() as loop:
            yield lambda url, **options: Awaited(loop, AsyncClient(url, **options))
    else:
        yield partial(Context.from_url, native=kind == "native")


@contextmanager
def running_loop() -> Iterator[asyncio.AbstractEventLoop]:
    """An event loop in a thread; whatever it complains of fails the test."""
    complaints: list[dict[str, Any]] = []
    loop = asyncio.new_event_loop()
    loop.set_exception_handler(lambda loop, context: complaints.append(context))
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    try:
        yield loop
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        left = asyncio.all_tasks(loop)
        loop.close()
    assert not complaints
    assert not left


class Awaited:
    """An AsyncClient as any thread sees it that waits for what it asks."""

    def __init__(self, loop: asyncio.AbstractEventLoop, plc: AsyncClient) -> None:
        vars(self).update(_loop=loop, _plc=plc)

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._plc, name)
        if not inspect.ismethod(found) and not inspect.isfunction(found):
            return found

        def call(*arguments: Any, **options: Any) -> Any:
            result = found(*arguments, **options)
            if not inspect.iscoroutine(result):
                return Awaited(self._loop, result)
            return asyncio.run_coroutine_threadsafe(result, self._loop).result(30)

        return call

    def __setattr__(self, name: str, value: Any) -> None:
        async def change() -> None:
            setattr(self._plc, name, value)

        asyncio.run_coroutine_threadsafe(change(), self._loop).result()

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
