"""Requests that are interrupted: by signals, finalizers, another thread, whatever a call raises."""

import asyncio
import contextlib
import gc
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, ModbusConnectionError, ModbusError, State
from tests.support.clients import ALL, Awaited, Connect, asking, connecting
from tests.support.peers import TcpPeer, ignore, mute_port, peer_at, until
from tests.support.reads import on_read, on_read_at
from tests.support.signals import on_alarm


class Interruption(BaseException):
    """An exception that a signal handler may raise."""


@contextlib.contextmanager
def connecting_here(kind: str) -> Iterator[Connect]:
    """Yield a function that makes clients; their event loop, if any, runs in this thread."""
    if kind == "asyncio":
        with asyncio.Runner() as runner:
            yield lambda url: Awaited(runner.run, AsyncClient(url))
    else:
        with connecting(kind) as connect:
            yield connect


@pytest.mark.parametrize(
    ("kind", "error"), [("blocking", Interruption), ("asyncio", ModbusConnectionError)]
)
def test_a_client_can_be_used_after_an_error_while_connecting(kind, error, monkeypatch):
    def interrupt(*_: object) -> None:
        raise Interruption

    with TcpPeer(on_read) as peer, connecting_here(kind) as connect:
        client = connect(peer.url)
        with monkeypatch.context() as patch:
            for name in ("connect", "connect_ex"):
                patch.setattr(socket.socket, name, interrupt)
            with pytest.raises(error):
                client.read_holding_registers(4, 1)
        assert client.state is State.DISCONNECTED
        assert client.read_holding_registers(4, 1) == [4]
        client.close()


@pytest.fixture
def answers(monkeypatch: pytest.MonkeyPatch) -> Iterator[threading.Event]:
    """Look-ups are as of a name server that does not answer, until it does; numbers need none."""
    look_up, answers = socket.getaddrinfo, threading.Event()

    def slow(
        host: Any, port: Any, family: int = 0, type: int = 0, proto: int = 0, flags: int = 0
    ) -> Any:
        if not flags & socket.AI_NUMERICHOST and host == "slow.invalid":
            answers.wait(120)
        return look_up(host, port, family, type, proto, flags | socket.AI_NUMERICHOST)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    yield answers
    answers.set()


@ALL
def test_the_timeout_includes_the_look_up_of_the_name(kind: str, answers: threading.Event) -> None:
    if kind == "asyncio":  # an event loop ends only after its look-ups
        threading.Timer(0.5, answers.set).start()
    with (
        pytest.raises(ModbusConnectionError, match=r"slow\.invalid"),
        asking(kind, "tcp://slow.invalid:502", timeout=0.1),
    ):
        pass


@pytest.mark.usefixtures("answers")
def test_close_does_not_wait_for_the_look_up_of_a_name() -> None:
    with ThreadPoolExecutor(1) as pool:
        context = Client("tcp://slow.invalid", timeout=600)
        future = pool.submit(context.connect)
        until(lambda: context.state is State.CONNECTING)
        time.sleep(0.02)
        context.close()
        with pytest.raises(ModbusConnectionError):
            future.result()


@contextlib.contextmanager
def waiting_context(place: str) -> Iterator[tuple[Client, Callable[[], object]]]:
    """A context, and a request on it that waits for long."""
    with contextlib.ExitStack() as stack:
        if place == "connecting":
            url = f"tcp://127.0.0.1:{stack.enter_context(mute_port())}"
        else:
            peer = stack.enter_context(peer_at(place, on_read_at(place)))
            url = peer.url
        context = Client(url, timeout=600)
        stack.callback(context.close)
        if place == "connecting":
            yield context, context.connect
            return
        for _ in range(2):
            context.read_holding_registers(1, 1)
        peer.on_request = ignore
        yield context, lambda: context.read_holding_registers(1, 1)


PLACES = pytest.mark.parametrize("place", ["tcp", "rtu", "connecting"])


@PLACES
def test_close_in_a_signal_handler_ends_the_request_that_it_interrupts(place: str) -> None:
    with waiting_context(place) as (context, request):
        with on_alarm(context.close, 0.05), pytest.raises(ModbusConnectionError):
            request()
        assert context.closed


@PLACES
def test_a_request_in_a_signal_handler_is_refused(place: str) -> None:
    refusals: list[bool] = []

    def ask() -> None:
        with pytest.raises(RuntimeError):
            context.read_coils(0, 1)
        refusals.append(True)

    with waiting_context(place) as (context, request):
        context.timeout = 0.15
        start = time.monotonic()
        with on_alarm(ask, 0.05), pytest.raises(ModbusError):
            request()
        assert time.monotonic() - start >= 0.149
        assert refusals


class Finalized:
    """Does something when it is collected, which a circle leaves to the collector."""

    def __init__(self, act: Callable[[], object]) -> None:
        self._act = act
        self._circle = self

    def __del__(self) -> None:
        self._act()


@contextlib.contextmanager
def other_process(scheme: str = "tcp") -> Iterator[str]:
    """A server that no collector, signal or fork of this process reaches; return its URL."""
    command = [sys.executable, "-m", "libmodbus_py", "serve", f"{scheme}://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.kill()


def test_close_and_requests_in_a_finalizer_during_a_request() -> None:
    """The collector runs whenever something is made, as in the middle of a request."""
    with other_process() as url, Client(url) as context:
        context.write_registers(0, list(range(100)))
        outcomes: list[object] = []

        def ask() -> None:
            try:
                outcomes.append(context.read_holding_registers(9, 1))
            except RuntimeError as error:
                outcomes.append(error)

        thresholds = gc.get_threshold()
        gc.set_threshold(5)
        try:
            for address in range(100):
                Finalized(ask)
                assert context.read_holding_registers(address, 1) == [address]
            gc.collect()
            assert len(outcomes) == 100
            assert all(outcome == [9] or isinstance(outcome, RuntimeError) for outcome in outcomes)
            Finalized(context.close)
            with contextlib.suppress(ModbusConnectionError):
                for _ in range(100):
                    context.read_holding_registers(1, 1)
        finally:
            gc.set_threshold(*thresholds)
        assert context.closed


@pytest.mark.parametrize("place", ["tcp", "rtu", "rtu+tcp"])
# A socket that was just being made is closed when it is collected.
@pytest.mark.filterwarnings("ignore:.*unclosed <socket.*")
def test_ctrl_c_at_any_moment_fails_no_later_request(place: str) -> None:
    """Each request that is not interrupted is right; no answer to an interrupted one is used."""
    with peer_at(place, on_read_at(place)) as peer, Client(peer.url, timeout=0.3) as context:
        interrupted = 0
        before = signal.signal(signal.SIGALRM, signal.default_int_handler)
        try:
            for number in range(200 if place == "tcp" else 24):
                try:
                    signal.setitimer(signal.ITIMER_REAL, 20e-6 + number % 100 * 6e-6)
                    for address in range(10):
                        assert context.read_holding_registers(address, 1) == [address]
                    signal.setitimer(signal.ITIMER_REAL, 0)
                except KeyboardInterrupt:
                    interrupted += 1
                if number % 2:
                    assert context.read_holding_registers(number, 1) == [number]
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)
        assert interrupted > 5


class Interrupted:
    """Raises KeyboardInterrupt in place of a method, so many times."""

    def __init__(self, patch: pytest.MonkeyPatch, owner: Any, name: str, times: int = 1) -> None:
        self._method, self._left = getattr(owner, name), times
        patch.setattr(owner, name, self)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        self._left -= 1
        if self._left >= 0:
            raise KeyboardInterrupt
        return self._method(*arguments, **options)


def test_the_request_after_an_interruption_uses_a_new_connection(monkeypatch: pytest.MonkeyPatch):
    with TcpPeer(on_read) as peer, Client(peer.url) as context:
        assert context.read_holding_registers(6, 1) == [6]
        driver = context._driver
        Interrupted(monkeypatch, driver, "_turn")
        Interrupted(monkeypatch, driver._connection, "interrupted")
        with pytest.raises(KeyboardInterrupt):
            context.read_holding_registers(7, 1)
        assert context.read_holding_registers(8, 1) == [8]
        assert context.state is State.CONNECTED
        assert context.statistics.connects == 2


def test_a_client_closed_during_an_interruption_is_closed_by_the_next_request(monkeypatch) -> None:
    with TcpPeer(on_read) as peer:
        context = Client(peer.url)
        assert context.read_holding_registers(6, 1) == [6]
        Interrupted(monkeypatch, context._driver, "_shut")
        with pytest.raises(KeyboardInterrupt):
            context.close()
        with pytest.raises(ModbusConnectionError, match="closed"):
            context.read_holding_registers(7, 1)
        assert context.state is State.CLOSED
        assert len(peer.requests) == 1
        context.close()
