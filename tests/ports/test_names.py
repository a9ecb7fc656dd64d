"""Look-ups of names that get no answer: they cost a few threads, and nobody waits for them."""

import asyncio
import os
import socket
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.ports.hosts import Resolve, ask
from libmodbus_py.ports.sockets import TcpPort
from libmodbus_py.ports.waiting import Steps, WaitInterrupted, Waker, look_up, run, run_async
from tests.support.peers import until

FOUND = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("192.0.2.1", 502))]


class Resolver:
    """
    In place of the system's: names that begin with "stuck" get no answer until `release` is set.
    """

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.release = threading.Event()

    def getaddrinfo(self, host: Any, *_: Any, flags: int = 0, **__: Any) -> Any:
        if flags & socket.AI_NUMERICHOST:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        self.asked.append(host)
        if host.startswith("stuck"):
            self.release.wait(60)
        if host.startswith("none"):
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return FOUND


def threads() -> int:
    return sum(thread.name == "look-up" for thread in threading.enumerate())


@pytest.fixture
def resolver(monkeypatch: pytest.MonkeyPatch) -> Iterator[Resolver]:
    resolver = Resolver()
    monkeypatch.setattr(socket, "getaddrinfo", resolver.getaddrinfo)
    yield resolver
    resolver.release.set()
    until(lambda: threads() == 0)


@pytest.fixture
def waker() -> Iterator[Waker]:
    waker = Waker()
    yield waker
    waker.close()


def wanted(host: str, seconds: float = 30.0) -> Resolve:
    return Resolve(host, 502, socket.SOCK_STREAM, time.monotonic() + seconds)


def resolving(host: str, seconds: float = 30.0) -> Steps[Any]:
    return (yield wanted(host, seconds))


def test_callers_of_one_name_share_a_look_up(resolver: Resolver) -> None:
    async def main() -> None:
        tasks = [asyncio.create_task(look_up(wanted("stuck"))) for _ in range(100)]
        await asyncio.sleep(0)
        assert threads() == 1
        resolver.release.set()
        assert await asyncio.gather(*tasks) == [FOUND] * 100

    asyncio.run(main())
    assert resolver.asked == ["stuck"]


def test_each_caller_gets_an_error_of_its_own(resolver: Resolver) -> None:
    async def main() -> list[BaseException | list[Any]]:
        return await asyncio.gather(
            *(look_up(wanted("none")) for _ in range(2)), return_exceptions=True
        )

    first, second = asyncio.run(main())
    assert isinstance(first, socket.gaierror)
    assert isinstance(second, socket.gaierror)
    assert first is not second
    assert first.errno == second.errno == socket.EAI_NONAME


async def test_no_look_up_waits_for_another_name(resolver: Resolver) -> None:
    """Addresses and localhost do not wait either, because no thread looks them up."""

    names = [f"stuck{number}" for number in range(100)]
    tasks = [asyncio.create_task(look_up(wanted(name))) for name in names]
    await asyncio.to_thread(until, lambda: len(resolver.asked) == 100)
    for name in ("localhost", "good"):
        assert await look_up(wanted(name)) == FOUND
    assert not any(task.done() for task in tasks)
    for task in tasks:
        task.cancel()


def test_a_name_has_one_thread_however_many_clients_give_up(resolver: Resolver) -> None:
    async def main() -> None:
        for _ in range(20):
            with pytest.raises(TimeoutError):
                await look_up(wanted("stuck", 0.0))
        assert threads() == 1

    asyncio.run(main())
    assert resolver.asked == ["stuck"]


def test_look_ups_use_none_of_the_threads_of_the_loop(resolver: Resolver):
    async def main() -> None:
        tasks = [
            asyncio.create_task(run_async(resolving(f"stuck{number}"))) for number in range(40)
        ]
        await asyncio.to_thread(until, lambda: len(resolver.asked) == 40)
        for task in tasks:
            task.cancel()
        assert await asyncio.to_thread(lambda: 7) == 7

    asyncio.run(main())
    assert not resolver.release.is_set()
    assert threads() > 0
    assert all(thread.daemon for thread in threading.enumerate() if thread.name == "look-up")


def test_blocking_and_asyncio_clients_share_a_look_up(resolver: Resolver, waker: Waker) -> None:
    results: list[Any] = []
    blocking = threading.Thread(target=lambda: results.append(run(resolving("stuck"), waker)))
    blocking.start()
    until(lambda: resolver.asked == ["stuck"])

    async def main() -> None:
        task = asyncio.create_task(look_up(wanted("stuck")))
        await asyncio.sleep(0)
        resolver.release.set()
        assert await task == FOUND

    asyncio.run(main())
    blocking.join()
    assert results == [FOUND]
    assert resolver.asked == ["stuck"]


@pytest.mark.parametrize("drive", [run, lambda steps, waker: asyncio.run(run_async(steps))])
def test_a_look_up_that_takes_too_long_is_a_connection_error(
    resolver: Resolver, waker: Waker, drive: Any
) -> None:
    with pytest.raises(ModbusConnectionError, match="it takes too long"):
        drive(TcpPort("stuck", 502, None).opening(time.monotonic() + 0.1), waker)


def test_a_blocking_client_that_looks_up_a_name_can_be_woken(resolver: Resolver, waker: Waker):
    def wake() -> None:
        until(lambda: resolver.asked)
        waker.wake()

    waking = threading.Thread(target=wake)
    waking.start()
    with pytest.raises(WaitInterrupted):
        run(resolving("stuck"), waker)
    waking.join()


def test_a_loop_that_was_closed_meanwhile_leaves_other_callers_their_result(resolver: Resolver):
    calls: list[int] = []

    def fails() -> None:
        raise RuntimeError("Event loop is closed")

    ask(wanted("stuck"), fails)
    question = ask(wanted("stuck"), lambda: calls.append(1))
    resolver.release.set()
    until(lambda: calls == [1])
    assert question.result() == FOUND


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (UnicodeError("label too long"), "it cannot be the name of a host"),
        (MemoryError("no memory"), "no memory"),
    ],
)
def test_errors_of_a_look_up_are_raised(monkeypatch, error, text) -> None:
    def getaddrinfo(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr(socket, "getaddrinfo", getaddrinfo)
    question = ask(wanted("name"), lambda: None)
    until(lambda: threads() == 0)
    with pytest.raises(OSError, match=f"{text}$"):
        question.result()


def test_a_failure_to_start_a_thread_is_raised(resolver: Resolver, waker: Waker, monkeypatch):
    def start(_: threading.Thread) -> None:
        raise RuntimeError("can't start new thread")

    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start)
        with pytest.raises(OSError, match="can't start new thread"):
            run(resolving("good"), waker)
    assert run(resolving("good"), waker) == FOUND
    assert resolver.asked == ["good"]


def test_a_forked_child_repeats_the_look_up_of_its_parent(resolver: Resolver) -> None:
    ask(wanted("stuck"), lambda: None)
    until(lambda: resolver.asked == ["stuck"])
    child = os.fork()
    if child == 0:
        result = 1
        try:
            resolver.release = threading.Event()
            resolver.release.set()
            result = int(run(resolving("stuck"), Waker()) != FOUND)
        finally:
            os._exit(result)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 0
