"""The same steps, run by polling and by an event loop."""

import asyncio
import contextlib
import os
import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from libmodbus_py import ModbusConnectionError
from libmodbus_py.ports.hosts import Resolve
from libmodbus_py.ports.sockets import TcpPort, UdpPort
from libmodbus_py.ports.waiting import (
    READ,
    WRITE,
    Ready,
    Steps,
    WaitInterrupted,
    Waker,
    milliseconds,
    run,
    run_async,
)
from tests.support.cases import each_case
from tests.support.names import NEEDS_IPV6, resolve
from tests.support.peers import mute_port, until

Drive = Callable[[Steps[Any]], Any]

# Seconds; the deadlines of what is woken or refused here are later.
BEFORE_ANY_DEADLINE = 5.0


@pytest.fixture
def waker() -> Iterator[Waker]:
    waker = Waker()
    yield waker
    waker.close()


@pytest.fixture(params=["polling", "event loop"])
def drive(request: pytest.FixtureRequest, waker: Waker) -> Drive:
    """Runs steps to their end."""
    if request.param == "polling":
        return lambda steps: run(steps, waker)
    return lambda steps: asyncio.run(run_async(steps))


@pytest.fixture
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    one, other = socket.socketpair()
    with one, other:
        yield one, other


def soon(seconds: float = 0.2) -> float:
    return time.monotonic() + seconds


def test_steps_get_readiness(drive: Drive, pair: tuple[socket.socket, socket.socket]) -> None:
    one, other = pair

    def steps() -> Steps[list[bool]]:
        empty = yield Ready(one.fileno(), READ, soon(0.05))
        writable = yield Ready(one.fileno(), WRITE, soon())
        other.send(b"x")
        full = yield Ready(one.fileno(), READ, soon())
        return [empty, writable, full]

    start = time.monotonic()
    assert drive(steps()) == [False, True, True]
    assert time.monotonic() - start >= 0.05


def test_a_wait_for_a_deadline_in_the_past_ends_at_once(
    drive: Drive, pair: tuple[socket.socket, socket.socket]
) -> None:
    def steps() -> Steps[bool]:
        return (yield Ready(pair[0].fileno(), READ, soon(-5)))

    assert drive(steps()) is False


def test_errors_of_steps_are_raised(drive: Drive) -> None:
    def steps() -> Steps[None]:
        yield from ()
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        drive(steps())


def resolving(host: str, seconds: float = 5) -> Steps[Any]:
    try:
        return (yield Resolve(host, 502, socket.SOCK_STREAM, soon(seconds)))
    except OSError as error:
        return error


@pytest.fixture
def own_name(monkeypatch: pytest.MonkeyPatch) -> str:
    """A name of this machine, which need not have /etc/hosts."""
    resolve(monkeypatch, "this-machine", "127.0.0.1")
    return "this-machine"


def test_names_and_addresses_are_resolved(drive: Drive, own_name: str) -> None:
    assert [row[4] for row in drive(resolving("127.0.0.1"))] == [("127.0.0.1", 502)]
    assert [row[4][:2] for row in drive(resolving("::1"))] == [("::1", 502)]
    assert "127.0.0.1" in [row[4][0] for row in drive(resolving(own_name))]


@pytest.mark.parametrize("host", ["no-such-host.invalid", "x" * 300, "a..b"])
def test_an_unknown_host_name_is_an_os_error(drive: Drive, host: str) -> None:
    assert isinstance(drive(resolving(host)), OSError)


def addresses(monkeypatch: pytest.MonkeyPatch, *ports: int) -> None:
    """A name with an address for each port."""
    answers = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port)) for port in ports]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: answers)


def test_a_dead_address_leaves_the_others_their_share_of_the_time(monkeypatch) -> None:
    clock = SimpleNamespace(monotonic=lambda: 100.0)
    monkeypatch.setattr("libmodbus_py.ports.sockets.time", clock)
    with (
        mute_port() as port,
        mute_port() as other,
        socket.create_server(("127.0.0.1", 0)) as listener,
    ):
        port_ = TcpPort("three-addresses.invalid", 502, None)
        steps = port_.opening(106.0)
        next(steps)
        addresses = [
            (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", number))
            for number in (port, other, listener.getsockname()[1])
        ]
        assert steps.send(addresses)[1:] == (WRITE, 102.0)
        clock.monotonic = lambda: 102.5
        assert steps.send(False)[1:] == (WRITE, 104.25)
        clock.monotonic = lambda: 104.25
        assert steps.send(False)[1:] == (WRITE, 106.0)
        with pytest.raises(StopIteration):
            steps.send(True)
        assert port_.descriptor >= 0
        port_.close()


def test_all_addresses_together_take_no_longer_than_the_deadline(drive: Drive, monkeypatch) -> None:
    with mute_port() as port:
        addresses(monkeypatch, port, port, port)
        start = time.monotonic()
        with pytest.raises(ModbusConnectionError, match="Connection timed out") as caught:
            drive(TcpPort("dead.invalid", 502, None).opening(start + 0.3))
        assert time.monotonic() - start >= 0.3
        assert isinstance(caught.value.__cause__, TimeoutError)


def test_a_refused_address_costs_no_time(drive: Drive, monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.socket() as sock, socket.create_server(("127.0.0.1", 0)) as listener:
        sock.bind(("127.0.0.1", 0))
        addresses(monkeypatch, sock.getsockname()[1], listener.getsockname()[1])
        port = TcpPort("two-addresses.invalid", 502, None)
        start = time.monotonic()
        drive(port.opening(start + 20))
        assert time.monotonic() - start < BEFORE_ANY_DEADLINE
        port.close()


@pytest.mark.parametrize(
    "host", ["this-machine", pytest.param("::1", marks=NEEDS_IPV6), "127.0.0.1"]
)
@pytest.mark.usefixtures("own_name")
def test_every_address_of_a_name_is_tried(drive: Drive, host: str) -> None:
    family = socket.AF_INET6 if host == "::1" else socket.AF_INET
    place = ("::1" if host == "::1" else "127.0.0.1", 0)
    with socket.create_server(place, family=family) as listener:
        port = TcpPort(host, listener.getsockname()[1], None)
        drive(port.opening(soon(5)))
        assert port.descriptor >= 0
        port.close()
        assert port.descriptor == -1


def test_udp_is_connected_at_once(drive: Drive) -> None:
    port = UdpPort("127.0.0.1", 502)
    drive(port.opening(soon()))
    assert port.receive() == []
    port.close()


def test_a_closed_udp_port_is_reported_after_its_answers_and_used_again_once_open() -> None:
    def listener(port: int = 0) -> socket.socket:
        port_ = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        port_.bind(("127.0.0.1", port))
        port_.settimeout(5)
        return port_

    with listener() as first:
        port_ = UdpPort("127.0.0.1", port := first.getsockname()[1])
        asyncio.run(run_async(port_.opening(soon())))
        port_.send([b"hello"], 0.0)
        first.sendto(b"answer", first.recvfrom(5)[1])
    port_.send([b"lost"], 0.0)
    with listener(port) as again:
        port_.send([b"request"], 0.0)
        assert again.recv(100) == b"request"
    port_.send([b"lost"], 0.0)
    assert port_.receive() == [b"answer"]
    with pytest.raises(ModbusConnectionError, match="refused"):
        port_.receive()
    port_.close()


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


@contextlib.contextmanager
def woken_after(waker: Waker, condition: Callable[[], object] = lambda: True) -> Iterator[None]:
    """Check that the block is woken at once."""

    def wake() -> None:
        until(condition)
        time.sleep(0.02)  # until the thread waits, which cannot be seen
        waker.wake()

    thread = threading.Thread(target=wake)
    before, start = descriptors(), time.monotonic()
    thread.start()
    with pytest.raises(WaitInterrupted):
        yield
    assert time.monotonic() - start < BEFORE_ANY_DEADLINE
    thread.join()
    assert descriptors() == before


def test_a_wake_ends_an_attempt_to_connect(waker: Waker) -> None:
    with mute_port() as port, woken_after(waker):
        run(TcpPort("127.0.0.1", port, None).opening(soon(10)), waker)


def test_a_pause_ends_when_it_is_woken(waker: Waker) -> None:
    with woken_after(waker):
        waker.wait(-1, READ, soon(10))


def test_a_cleared_waker_does_not_wake(waker: Waker) -> None:
    waker.clear()
    waker.wake()
    waker.wake()
    waker.clear()
    assert not waker.wait(-1, READ, time.monotonic() + 0.01)
    waker.wake()
    with pytest.raises(WaitInterrupted):
        waker.wait(-1, READ, time.monotonic() + 10)
    waker.close()
    waker.clear()


def test_a_waker_woken_before_a_wait_ends_it_at_once(waker: Waker) -> None:
    waker.wake()
    waker.wake()
    for _ in range(2):
        with pytest.raises(WaitInterrupted):
            waker.wait(-1, READ, soon(10))


def test_a_waker_may_be_closed_and_woken_any_number_of_times() -> None:
    waker = Waker()
    before = descriptors()
    waker.close()
    assert descriptors() == before - 1
    waker.close()
    waker.wake()
    assert waker.descriptor == -1


def test_cancelling_closes_the_socket() -> None:
    async def main(port: int) -> None:
        before = descriptors()
        opening = asyncio.create_task(run_async(TcpPort("127.0.0.1", port, None).opening(soon(10))))
        await asyncio.sleep(0.02)
        assert descriptors() == before + 1
        opening.cancel()
        with pytest.raises(asyncio.CancelledError):
            await opening
        assert descriptors() == before

    with mute_port() as port:
        asyncio.run(main(port))


@each_case(
    ("seconds", "rounded"),
    [(0, 0), (-1, 0), (0.0001, 1), (0.001, 1), (0.0011, 2), (1, 1000), (1e9, 86_400_000)],
)
def test_milliseconds_are_rounded_up_and_limited_to_a_day(seconds: float, rounded: int) -> None:
    assert milliseconds(seconds) == rounded
    assert milliseconds(float("inf")) == 86_400_000


class Counted:
    """In place of `poll`: nothing is ready, and the clock moves by the time waited."""

    def __init__(self) -> None:
        self.now = 0.0
        self.waits: list[int] = []

    def poll(self, milliseconds: int) -> list[tuple[int, int]]:
        self.waits.append(milliseconds)
        self.now += milliseconds / 1000
        return []

    def register(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("seconds", [0.0, 0.5, 1.0, 1.0005, 90_000.5])
def test_the_system_waits_a_second_at_a_time(seconds, monkeypatch) -> None:
    """A signal just before a wait does not end it: its handler must not wait for a timeout."""
    polls = Counted()
    monkeypatch.setattr(select, "poll", lambda: polls)
    waker = Waker()
    waker.now = lambda: polls.now
    waker.watch(-1)
    for wait in (
        lambda: waker.is_ready(seconds),
        lambda: waker.wait(-1, READ, polls.now + seconds),
    ):
        before = polls.now
        assert not wait()
        assert seconds <= polls.now - before <= seconds + 0.0011
    assert max(polls.waits) <= 1000
    waker.close()
