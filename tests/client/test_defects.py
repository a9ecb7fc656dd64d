"""
Faults that were found by attacking the clients, each by what it looked like to a caller.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import gc
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Context,
    Device,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    RtuContext,
    Server,
    State,
    TcpContext,
)
from libmodbus_py.testing.wires import SerialWire
from tests.support.clients import ALL, BLOCKING, NATIVE, asking, read
from tests.support.peers import FakeServer, FakeUnit, answer, dead, until
from tests.support.scripted import Scripted, echo
from tests.support.scripted import run as run_watched


def rtu(request: bytes) -> bytes:
    return answer(request, "rtu")


# --- connections that died, and are being made -----------------------------------------------


class Interruption(BaseException):
    """What a signal handler may raise."""


@ALL
def test_anything_raised_while_it_connects_leaves_a_client_that_can(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with FakeServer(lambda request: [answer(request, "tcp")]) as server:
        chosen: dict[str, Any] = {"native": {}, "python": {"native": False}}.get(kind, {})
        url = f"tcp://127.0.0.1:{server.port}"

        def interrupt(*_: object) -> None:
            raise Interruption

        if kind == "asyncio":
            with asyncio.Runner() as runner:
                client = AsyncClient(url)

                async def read() -> list[int]:
                    return await client.read_holding_registers(4, 1)

                with monkeypatch.context() as patch:
                    for name in ("connect", "connect_ex"):
                        patch.setattr(socket.socket, name, interrupt)
                    with pytest.raises((Interruption, ModbusConnectionError)):
                        runner.run(read())
                assert runner.run(read()) == [4]
                runner.run(client.close())
            return
        context = Context.from_url(url, **chosen)
        with monkeypatch.context() as patch:
            for name in ("connect", "connect_ex"):
                patch.setattr(socket.socket, name, interrupt)
            with pytest.raises(Interruption):
                context.read_holding_registers(4, 1)
        assert context.read_holding_registers(4, 1) == [4]
        context.close()


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


@BLOCKING
@pytest.mark.parametrize("named", [False, True])
@pytest.mark.usefixtures("answers")
def test_close_does_not_wait_for_a_connection_that_is_being_made(named: bool, kind: str) -> None:
    with dead() as port:
        host = "slow.invalid" if named else "127.0.0.1"
        context = TcpContext(host, port, timeout=600, native=kind == "native")
        failed: list[BaseException] = []

        def connect() -> None:
            try:
                context.connect()
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=connect)
        thread.start()
        until(lambda: context.state is State.CONNECTING)
        time.sleep(0.02)
        context.close()
        thread.join()
        assert isinstance(failed[0], ModbusConnectionError)


@ALL
def test_connecting_and_the_answer_have_one_timeout(kind: str) -> None:
    """Half of it is spent on an address that is dead."""

    with FakeServer(lambda request: []) as server, dead() as port_of_nobody:
        both = [
            (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port))
            for port in (port_of_nobody, server.port)
        ]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(socket, "getaddrinfo", lambda *_, **__: both)
            context = None
            start = time.monotonic()
            if kind == "asyncio":

                async def main() -> None:
                    client = AsyncClient("tcp://two.invalid:502", timeout=0.4)
                    try:
                        with pytest.raises(ModbusTimeoutError):
                            await client.read_holding_registers(1, 1)
                    finally:
                        await client.close()

                run_watched(main())
            else:
                context = TcpContext("two.invalid", timeout=0.4, native=kind == "native")
                with pytest.raises(ModbusTimeoutError):
                    context.read_holding_registers(1, 1)
                context.close()
        assert time.monotonic() - start >= 0.39
        assert server.connections == 1


# --- close and requests from where they hurt --------------------------------------------------


@contextlib.contextmanager
def on_alarm(act: Callable[[], object], seconds: float) -> Iterator[list[BaseException]]:
    """Let a signal handler do it; gives what it raised."""
    raised: list[BaseException] = []

    def handle(*_: object) -> None:
        try:
            act()
        except Exception as error:
            raised.append(error)

    before = signal.signal(signal.SIGALRM, handle)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield raised
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


@contextlib.contextmanager
def waiting_context(place: str, native: bool) -> Iterator[tuple[Context, Callable[[], object]]]:
    """A context, and a request on it that waits for long."""
    if place == "tcp":
        good = lambda request: [answer(request, "tcp")]  # noqa: E731
        with FakeServer(good, good, lambda request: []) as server:
            context = TcpContext("127.0.0.1", server.port, timeout=600, native=native)
            context.read_holding_registers(1, 1)
            context.read_holding_registers(1, 1)
            yield context, lambda: context.read_holding_registers(1, 1)
    elif place == "rtu":
        line = lambda request: [rtu(request)]  # noqa: E731
        with FakeUnit(line, line, lambda request: []) as unit:
            context = RtuContext(unit.path, 115200, timeout=600, native=native)
            context.read_holding_registers(1, 1)
            context.read_holding_registers(1, 1)
            yield context, lambda: context.read_holding_registers(1, 1)
    else:
        with dead() as port:
            context = TcpContext("127.0.0.1", port, timeout=600, native=native)
            yield context, context.connect
    context.close()


PLACES = pytest.mark.parametrize("place", ["tcp", "rtu", "connecting"])


@NATIVE
@PLACES
def test_close_in_a_signal_handler_ends_the_request_that_it_interrupts(
    place: str, native: bool
) -> None:
    with waiting_context(place, native) as (context, request):
        with on_alarm(context.close, 0.05) as raised, pytest.raises(ModbusConnectionError):
            request()
        assert not raised
        assert context.closed


@NATIVE
@PLACES
def test_a_request_in_a_signal_handler_is_refused(place: str, native: bool) -> None:
    with waiting_context(place, native) as (context, request):
        context.timeout = 0.15
        start = time.monotonic()
        with (
            on_alarm(lambda: context.read_coils(0, 1), 0.05) as raised,
            pytest.raises(ModbusError),
        ):
            request()
        assert time.monotonic() - start >= 0.149
        assert isinstance(raised[0], RuntimeError)


class Finalized:
    """Does something when it is collected, which a circle leaves to the collector."""

    def __init__(self, act: Callable[[], object]) -> None:
        self._act = act
        self._circle = self

    def __del__(self) -> None:
        self._act()


@contextlib.contextmanager
def other_process(scheme: str = "tcp") -> Iterator[str]:
    """A server that no collector, signal or fork of this process reaches; gives its URL."""
    command = [sys.executable, "-m", "libmodbus_py", "serve", f"{scheme}://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split()[-1]
        finally:
            process.kill()


@NATIVE
def test_close_and_requests_in_a_finalizer_during_a_request(native: bool) -> None:
    """The collector runs whenever something is made, as in the middle of a request."""
    with other_process() as url, Context.from_url(url, native=native) as context:
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
            assert all(each == [9] or isinstance(each, RuntimeError) for each in outcomes)
            Finalized(context.close)
            with contextlib.suppress(ModbusConnectionError):
                for _ in range(100):
                    context.read_holding_registers(1, 1)
        finally:
            gc.set_threshold(*thresholds)
        assert context.closed


@NATIVE
@pytest.mark.parametrize("place", ["tcp", "rtu", "rtu+tcp"])
# A socket that was just being made is closed when it is collected.
@pytest.mark.filterwarnings("ignore:.*unclosed <socket.*")
def test_ctrl_c_at_any_moment_fails_no_later_request(place: str, native: bool) -> None:
    """Each request that is not interrupted is right; none meets what an interrupted one left."""
    with contextlib.ExitStack() as stack:
        context: Context
        if place == "rtu":
            unit = stack.enter_context(FakeUnit(lambda request: [rtu(request)]))
            context = RtuContext(unit.path, 1_000_000, timeout=0.1, native=native)
        else:
            frame = lambda request: [answer(request, place)]  # noqa: E731
            server = stack.enter_context(FakeServer(frame))
            framed: Any = "rtu" if place == "rtu+tcp" else "tcp"
            context = TcpContext(
                "127.0.0.1", server.port, framing=framed, timeout=0.1, native=native
            )
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
        context.close()


# --- ASCII delimiters ---------------------------------------------------------------------------


@ALL
@pytest.mark.parametrize("scheme", ["ascii+tcp", "ascii"])
def test_an_accepted_delimiter_is_followed_and_a_restart_ends_it(scheme: str, kind: str) -> None:
    with contextlib.ExitStack() as stack:
        server = Server(Device(Mapping(holding_registers=10)))
        if scheme == "ascii":
            wire = stack.enter_context(SerialWire())
            stack.enter_context(server.background(f"ascii://{wire.server}?baudrate=115200"))
            url = f"ascii://{wire.client}?baudrate=115200"
        else:
            url = stack.enter_context(server.background("ascii+tcp://127.0.0.1:0")).urls[0]
        client = stack.enter_context(asking(kind, url))
        client.write_register(3, 42)
        client.diagnostics(3, 0x2100)
        assert read(client, 3) == 42
        client.diagnostics(3, 0x2400)
        assert read(client, 3) == 42
        with pytest.raises(ModbusError):  # a colon ends nothing
            client.diagnostics(3, 0x3A00)
        assert read(client, 3) == 42
        client.diagnostics(1)
        assert read(client, 3) == 42


@ALL
@pytest.mark.parametrize("in_url", [True, False])
def test_a_delimiter_that_the_device_has_already_is_an_option(in_url: bool, kind: str) -> None:
    def with_dollar(request: bytes) -> list[bytes]:
        assert request.endswith(b"\r$")
        return [answer(request, "ascii")[:-1] + b"$"]

    query, options = ("&delimiter=0x24", {}) if in_url else ("", {"delimiter": 0x24})
    with (
        FakeUnit(with_dollar) as unit,
        asking(kind, f"ascii://{unit.path}?baudrate=115200{query}", **options) as client,
    ):
        assert read(client, 3) == 3


# --- what is left behind ------------------------------------------------------------------------


def forgotten(main: Any) -> None:
    asyncio.run(main)
    gc.collect()


def test_a_forgotten_client_says_so_and_frees_its_port() -> None:
    with FakeUnit(lambda request: [rtu(request)]) as unit:

        async def forget() -> None:
            client = AsyncClient(f"rtu://{unit.path}?baudrate=115200")
            assert await client.read_holding_registers(3, 1) == [3]

        for times in range(2):
            with pytest.warns(ResourceWarning, match=unit.path):
                forgotten(forget())
            with RtuContext(unit.path, 115200) as context:
                assert context.read_holding_registers(times, 1) == [times]


@pytest.mark.filterwarnings("error::ResourceWarning")
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_forgotten_client_frees_its_port_where_warnings_are_errors() -> None:
    with FakeUnit(lambda request: [rtu(request)]) as unit:

        async def forget() -> None:
            client = AsyncClient(f"rtu://{unit.path}?baudrate=115200")
            assert await client.read_holding_registers(3, 1) == [3]

        asyncio.run(forget())
        gc.collect()
        with RtuContext(unit.path, 115200) as context:
            assert context.read_holding_registers(1, 1) == [1]


def test_a_client_forgotten_while_it_connects_leaves_nothing() -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server:
            for steps in range(6):
                client = AsyncClient(server.url)
                asked = asyncio.create_task(client.connect())
                for _ in range(steps):
                    await asyncio.sleep(0)
                asked.cancel()
                await asyncio.wait([asked])
                del client, asked
                gc.collect()
            await asyncio.sleep(0.05)
            assert not [writer for writer in server.writers if not at_end(writer)]

    def at_end(writer: asyncio.StreamWriter) -> bool:
        return writer.transport.is_closing() or writer.transport.get_extra_info("socket") is None

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)
        run_watched(main())


def test_a_port_is_opened_that_a_killed_program_left_as_it_was() -> None:
    """Its settings are those that are to be set, and a pseudo-terminal refuses one of them."""
    with FakeUnit(lambda request: [rtu(request)]) as unit:
        program = (
            "import os, sys, libmodbus_py as m\n"
            "context = m.RtuContext(sys.argv[1], 115200)\n"
            "context.connect()\n"
            "os.kill(os.getpid(), 9)"
        )
        for times in range(3):
            subprocess.run([sys.executable, "-c", program, unit.path], check=False, timeout=30)
            if times:
                with RtuContext(unit.path, 115200) as context:
                    assert context.read_holding_registers(times, 1) == [times]


# --- noise, dead units, strange devices ----------------------------------------------------------


@ALL
def test_a_byte_right_behind_a_flush_does_not_reopen_the_port(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As a line picks up while nobody talks; each opening locks the port."""
    lock, flush, locks = fcntl.flock, termios.tcflush, []

    def counted(*args: Any) -> None:
        locks.append(args)
        lock(*args)

    def followed(*args: Any) -> None:
        flush(*args)
        unit.write(b"\x00")
        time.sleep(0.002)

    monkeypatch.setattr(fcntl, "flock", counted)
    with (
        FakeUnit(lambda request: [rtu(request)]) as unit,
        asking(kind, f"rtu://{unit.path}?baudrate=115200") as client,
    ):
        monkeypatch.setattr(termios, "tcflush", followed)
        for address in range(10):
            unit.write(b"\x00")
            time.sleep(0.003)
            assert read(client, address) == address
        assert len(locks) == 1
        assert client.state is State.CONNECTED
        assert client.statistics.lost == 0
