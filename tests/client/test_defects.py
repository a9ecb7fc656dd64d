"""
Faults that were found by attacking the clients, each by what it looked like to a caller.
"""

from __future__ import annotations

import asyncio
import contextlib
import fcntl
import gc
import os
import signal
import socket
import subprocess
import sys
import termios
import threading
import time
import tracemalloc
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
    framing,
)
from libmodbus_py.testing.wires import SerialWire
from tests.support.asking import ALL, BLOCKING, NATIVE, answer, asking
from tests.support.fake import FakeServer, FakeUnit, mbap
from tests.support.pace import LATE
from tests.support.scripted import Scripted, echo
from tests.support.scripted import run as run_watched


def rtu(request: bytes) -> bytes:
    return answer(request, "rtu")


# --- answers that come twice, late, or after something else ---------------------------------


@ALL
def test_a_unit_that_answers_twice_gives_no_wrong_values(kind: str) -> None:
    def twice(request: bytes) -> Iterator[bytes]:
        yield rtu(request)
        time.sleep(0.001)
        yield rtu(request)

    # More silence than is specified, for a busy machine may be late with the second one.
    with FakeUnit(twice) as unit, asking(kind, f"rtu://{unit.path}?silence=0.03") as client:
        assert [client.read(address) for address in range(50)] == list(range(50))


STRAYS: dict[str, Callable[[bytes], bytes]] = {
    "00": lambda request: b"\x00",
    "FF": lambda request: b"\xff",
    "FE 00": lambda request: b"\xfe\x00",
    "unit": lambda request: answer(request, "rtu", unit=9),
    "echo": lambda request: request,
    "00 and echo": lambda request: b"\x00" + request,
}


@ALL
@pytest.mark.parametrize("pause", [0, 0.03])
@pytest.mark.parametrize("stray", STRAYS)
def test_what_stands_before_each_answer_on_a_line_harms_none(
    stray: str, pause: float, kind: str
) -> None:
    """A transceiver that turns round makes bytes; a pause is longer than the framer's silence."""

    def strayed(request: bytes) -> Iterator[bytes]:
        yield STRAYS[stray](request) + (b"" if pause else rtu(request))
        if pause:
            time.sleep(pause)
            yield rtu(request)

    with FakeUnit(strayed) as unit, asking(kind, f"rtu://{unit.path}?baudrate=115200") as client:
        assert [client.read(address) for address in range(40)] == list(range(40))


@ALL
def test_echoes_of_writes_are_their_answers_or_harm_none(kind: str) -> None:
    def echoed(request: bytes) -> list[bytes]:
        return [request, request[:6] + framing.crc16(request[:6]).to_bytes(2, "little")]

    with FakeUnit(echoed) as unit, asking(kind, f"rtu://{unit.path}?baudrate=115200") as client:
        for address in range(20):
            client.write_register(address, 1)
            client.write_registers(address, [1, 2])


@ALL
def test_an_answer_with_another_id_before_each_answer_harms_none(kind: str) -> None:
    def with_other(request: bytes) -> list[bytes]:
        other = mbap(
            request, b"\x03\x02\xff\xff", transaction=int.from_bytes(request[:2], "big") ^ 0x5555
        )
        return [other + answer(request, "tcp")]

    with FakeServer(with_other) as server, asking(kind, f"tcp://127.0.0.1:{server.port}") as client:
        assert [client.read(address) for address in range(40)] == list(range(40))
        assert server.connections == 1


@ALL
def test_a_late_answer_during_a_request_does_not_fail_it(kind: str) -> None:
    """It comes while the second request after the one that was given up waits."""

    class Late:
        owed = b""

        def __call__(self, request: bytes) -> Iterator[bytes]:
            address = int.from_bytes(request[8:10], "big")
            if address == 7:
                self.owed = answer(request, "tcp")
                return
            if address == 3:
                time.sleep(0.02)
                yield self.owed
                time.sleep(0.02)
            yield answer(request, "tcp")

    with FakeServer(Late()) as server, asking(kind, f"tcp://127.0.0.1:{server.port}") as client:
        for _ in range(3):
            assert client.read(1) == 1
            client.client.timeout = 0.05
            with pytest.raises(ModbusTimeoutError):
                client.read(7)
            client.client.timeout = 1
            assert [client.read(address) for address in (2, 3)] == [2, 3]
        assert client.client.late_answers == 3
        assert server.connections == 1


# --- floods --------------------------------------------------------------------------------


class Flood:
    """A server that sends without end, from the first request on."""

    def __init__(self, data: bytes, udp: bool = False) -> None:
        self._data = data
        self._udp = udp

    def __enter__(self) -> Flood:
        kind = socket.SOCK_DGRAM if self._udp else socket.SOCK_STREAM
        self._socket = socket.socket(socket.AF_INET, kind)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.05)
        self.port = self._socket.getsockname()[1]
        if not self._udp:
            self._socket.listen()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(OSError):
                if self._udp:
                    _, peer = self._socket.recvfrom(300)
                    while not self._over.is_set():
                        self._socket.sendto(self._data, peer)
                else:
                    peer, _ = self._socket.accept()
                    with peer:
                        peer.settimeout(5)
                        peer.recv(300)
                        while not self._over.is_set():
                            peer.sendall(self._data)


FLOODS: dict[str, tuple[str, bytes]] = {
    "digits": ("ascii+tcp", b"0123456789ABCDEF" * 4096),
    "colons and digits": ("ascii+tcp", (b":" + b"0123456789ABCDEF" * 100) * 40),
    "frames with other ids": ("tcp", bytes.fromhex("FFFF0000000501030200AA") * 4096),
    "headers of another protocol": ("tcp", bytes.fromhex("800100070005010302000A") * 4096),
    "datagrams": ("udp", bytes.fromhex("FFFF0000000501030200AA")),
    "large datagrams": ("udp", bytes(60_000)),
    "noise": ("rtu+tcp", os.urandom(65536)),
    "starts of frames": ("rtu+tcp", b"\x01\x03\xfa" * 20_000),
    "frames of another unit": ("rtu+tcp", bytes.fromhex("09030200AAD9FB") * 8192),
}


@ALL
@pytest.mark.parametrize("flood", FLOODS)
def test_a_flood_costs_neither_time_nor_memory(flood: str, kind: str) -> None:
    scheme, data = FLOODS[flood]
    with Flood(data, scheme == "udp") as server:
        url = f"{scheme}://127.0.0.1:{server.port}"
        silence = 0.0 if scheme in ("tcp", "udp") else 0.3
        with asking(kind, url, timeout=0.3) as client:
            for most in (0.3, silence + 0.3):
                start = time.monotonic()
                error = failure(client.read, 1)
                assert time.monotonic() - start < most + LATE
                assert len(error.received) <= 600
                assert len(str(error)) < 300
            tracemalloc.start()
            try:
                failure(client.read, 1)
                kept, most = tracemalloc.get_traced_memory()
            finally:
                tracemalloc.stop()
    assert kept < 64 * 1024
    assert most < 512 * 1024  # what is looked at in one turn


def failure(act: Callable[..., object], *args: Any) -> ModbusError:
    with pytest.raises(ModbusError) as caught:
        act(*args)
    return caught.value


FLOODER = """
import contextlib, os, sys, time
while True:
    with contextlib.suppress(BlockingIOError):  # there is no room
        os.write(int(sys.argv[1]), bytes.fromhex(sys.argv[2]))
    time.sleep(float(sys.argv[3]))
"""


@contextlib.contextmanager
def noisy_line(noise: bytes, pause: float) -> Iterator[str]:
    """A serial line on which another process writes without end."""
    with FakeUnit(lambda request: []) as unit:
        fd = unit._master
        command = [sys.executable, "-c", FLOODER, str(fd), noise.hex(), str(pause)]
        with subprocess.Popen(command, pass_fds=[fd]) as process:
            try:
                yield unit.path
            finally:
                process.kill()


@ALL
@pytest.mark.parametrize("scheme", ["rtu", "ascii"])
@pytest.mark.parametrize("pause", [0, 0.001, 0.02])
def test_a_line_that_is_never_quiet_ends_the_wait(pause: float, scheme: str, kind: str) -> None:
    """From the first request on, and while it waits for the silence that must come before."""
    noise = b"0123456789ABCDEF" if scheme == "ascii" else bytes(range(0x80, 0x90))
    with (
        noisy_line(noise, pause) as path,
        asking(kind, f"{scheme}://{path}?baudrate=115200", timeout=0.2) as client,
    ):
        for _ in range(3):
            start = time.monotonic()
            with pytest.raises(ModbusError) as caught:
                client.read(1)
            assert time.monotonic() - start < 2 * 0.2 + LATE
            assert len(caught.value.received) <= 600
            assert len(str(caught.value)) < 300


# --- connections that died, and are being made -----------------------------------------------


@contextlib.contextmanager
def dumb_after(first: int) -> Iterator[int]:
    """A server whose first connection goes dumb after so many answers; the others are good."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        over = threading.Event()
        numbers = iter(range(100))

        def serve(peer: socket.socket, most: float) -> None:
            with peer, contextlib.suppress(OSError):
                while request := peer.recv(12):
                    if most > 0:
                        peer.sendall(answer(request, "tcp"))
                    most -= 1

        def accept() -> None:
            with contextlib.suppress(OSError):
                while not over.is_set():
                    peer, _ = listener.accept()
                    most = first if next(numbers) == 0 else 1e9
                    threading.Thread(target=serve, args=(peer, most), daemon=True).start()

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield listener.getsockname()[1]
        over.set()
        listener.shutdown(socket.SHUT_RDWR)
        thread.join()


def test_a_dead_connection_is_left_though_the_caller_has_less_patience() -> None:
    async def main(port: int) -> None:
        async with AsyncClient(f"tcp://127.0.0.1:{port}", timeout=1) as client:
            assert await client.read_holding_registers(1, 1) == [1]
            failed = 0
            for address in range(20):
                try:
                    async with asyncio.timeout(0.2):
                        assert await client.read_holding_registers(address, 1) == [address]
                except TimeoutError:
                    failed += 1
            assert failed == 3
            assert client.statistics.connects == 2

    with dumb_after(1) as port:
        run_watched(main(port))


@BLOCKING
def test_a_dead_connection_is_left_by_a_context(kind: str) -> None:
    with (
        dumb_after(1) as port,
        asking(kind, f"tcp://127.0.0.1:{port}", timeout=0.1) as client,
    ):
        assert client.read(1) == 1
        for _ in range(3):
            with pytest.raises(ModbusTimeoutError):
                client.read(2)
        assert client.read(3) == 3


def test_cancelled_while_it_connects_a_client_can_connect_again() -> None:
    """At each step of the event loop, and whoever is cancelled: the caller, or all tasks."""

    async def main() -> None:
        async with Scripted(echo).serving() as server:
            for steps in range(8):
                for everybody in (False, True):
                    client = AsyncClient(server.url, timeout=1)
                    asked = asyncio.create_task(client.read_holding_registers(5, 1))
                    for _ in range(steps):
                        await asyncio.sleep(0)
                    for task in asyncio.all_tasks() if everybody else ():
                        if "libmodbus_py" in task.get_coro().cr_code.co_filename:
                            task.cancel()
                    asked.cancel()
                    await asyncio.wait([asked])
                    async with asyncio.timeout(1):
                        assert await client.read_holding_registers(6, 1) == [6]
                    await client.close()

    run_watched(main())


class Interruption(BaseException):
    """What a signal handler may raise."""


@ALL
def test_anything_raised_while_it_connects_leaves_a_client_that_can(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with FakeServer(lambda request: [answer(request, "tcp")]) as server:
        chosen: dict[str, Any] = {"native": {}, "framed": {"native": False}}.get(kind, {})
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
            answers.wait(30)
        return look_up(host, port, family, type, proto, flags | socket.AI_NUMERICHOST)

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    yield answers
    answers.set()


@ALL
def test_the_timeout_includes_the_look_up_of_the_name(kind: str, answers: threading.Event) -> None:
    if kind == "asyncio":  # an event loop ends only after its look-ups
        threading.Timer(1, answers.set).start()
    start = time.monotonic()
    with (
        pytest.raises(ModbusConnectionError, match=r"slow\.invalid"),
        asking(kind, "tcp://slow.invalid:502", timeout=0.2),
    ):
        pass
    assert time.monotonic() - start < (1 if kind == "asyncio" else 0.2) + LATE


@contextlib.contextmanager
def full() -> Iterator[int]:
    """A port that neither takes a connection nor refuses it."""
    with socket.socket() as listener, contextlib.ExitStack() as stack:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(4):
            made = stack.enter_context(socket.socket())
            made.setblocking(False)
            made.connect_ex(listener.getsockname())
        yield listener.getsockname()[1]


@BLOCKING
@pytest.mark.parametrize("named", [False, True])
@pytest.mark.usefixtures("answers")
def test_close_does_not_wait_for_a_connection_that_is_being_made(named: bool, kind: str) -> None:
    with full() as port:
        host = "slow.invalid" if named else "127.0.0.1"
        context = TcpContext(host, port, timeout=10, native=kind == "native")
        failed: list[BaseException] = []

        def connect() -> None:
            try:
                context.connect()
            except BaseException as error:
                failed.append(error)

        thread = threading.Thread(target=connect)
        thread.start()
        time.sleep(0.1)
        start = time.monotonic()
        context.close()
        assert time.monotonic() - start < LATE
        thread.join()
        assert time.monotonic() - start < LATE
        assert isinstance(failed[0], ModbusConnectionError)


@ALL
def test_connecting_and_the_answer_have_one_timeout(kind: str) -> None:
    """Half of it is spent on an address that is dead."""

    with FakeServer(lambda request: []) as server, full() as dead:
        both = [
            (socket.AF_INET, socket.SOCK_STREAM, 6, "", ("127.0.0.1", port))
            for port in (dead, server.port)
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
        assert 0.39 < time.monotonic() - start < 0.4 + LATE
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
            context = TcpContext("127.0.0.1", server.port, timeout=20, native=native)
            context.read_holding_registers(1, 1)
            context.read_holding_registers(1, 1)
            yield context, lambda: context.read_holding_registers(1, 1)
    elif place == "rtu":
        line = lambda request: [rtu(request)]  # noqa: E731
        with FakeUnit(line, line, lambda request: []) as unit:
            context = RtuContext(unit.path, 115200, timeout=20, native=native)
            context.read_holding_registers(1, 1)
            context.read_holding_registers(1, 1)
            yield context, lambda: context.read_holding_registers(1, 1)
    else:
        with full() as port:
            context = TcpContext("127.0.0.1", port, timeout=20, native=native)
            yield context, context.connect
    context.close()


PLACES = pytest.mark.parametrize("place", ["tcp", "rtu", "connecting"])


@NATIVE
@PLACES
def test_close_in_a_signal_handler_ends_the_request_that_it_interrupts(
    place: str, native: bool
) -> None:
    with waiting_context(place, native) as (context, request):
        start = time.monotonic()
        with on_alarm(context.close, 0.1) as raised, pytest.raises(ModbusConnectionError):
            request()
        assert time.monotonic() - start < 0.1 + LATE
        assert not raised
        assert context.closed


@NATIVE
@PLACES
def test_a_request_in_a_signal_handler_is_refused(place: str, native: bool) -> None:
    with waiting_context(place, native) as (context, request):
        context.timeout = 0.4
        start = time.monotonic()
        with (
            on_alarm(lambda: context.read_coils(0, 1), 0.1) as raised,
            pytest.raises(ModbusError),
        ):
            request()
        assert 0.3 < time.monotonic() - start < 0.4 + LATE
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
            for number in range(200 if place == "tcp" else 40):
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
        assert interrupted > 10
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
        assert client.read(3) == 42
        client.diagnostics(3, 0x2400)
        assert client.read(3) == 42
        with pytest.raises(ModbusError):  # a colon ends nothing
            client.diagnostics(3, 0x3A00)
        assert client.read(3) == 42
        client.diagnostics(1)
        assert client.read(3) == 42


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
        assert client.read(3) == 3


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


# --- processor time -------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "udp"])
def test_an_idle_client_that_is_flooded_rests(scheme: str) -> None:
    noise = b"" if scheme == "rtu+tcp" else bytes.fromhex("FFFF0000000501030200AA")
    with SendingProcess(scheme, noise or bytes(range(256))) as url:

        async def main() -> None:
            async with AsyncClient(url, timeout=1) as client:
                assert await client.read_holding_registers(3, 1) == [3]
                await asyncio.sleep(0.1)
                before = time.process_time()
                await asyncio.sleep(0.5)
                assert time.process_time() - before < 0.2
                assert await client.read_holding_registers(4, 1) == [4]

        run_watched(main())


def test_an_idle_client_on_a_noisy_line_rests() -> None:
    with noisy_line(bytes(range(0x80, 0x90)), 0.0) as path:

        async def main() -> None:
            async with AsyncClient(f"rtu://{path}?baudrate=115200", timeout=0.2) as client:
                with pytest.raises(ModbusError):
                    await client.read_holding_registers(3, 1)
                await asyncio.sleep(0.3)
                before = time.process_time()
                await asyncio.sleep(0.5)
                assert time.process_time() - before < 0.2

        run_watched(main())


SENDING = """
import socket, sys
kind, noise = sys.argv[1], bytes.fromhex(sys.argv[2])
data = noise * (60000 // len(noise)) if kind != "udp" else noise
from tests.support.asking import answer
listener = socket.socket(type=socket.SOCK_DGRAM if kind == "udp" else socket.SOCK_STREAM)
listener.bind(("127.0.0.1", 0))
if kind != "udp":
    listener.listen()
print(listener.getsockname()[1], flush=True)
if kind == "udp":
    while True:
        request, peer = listener.recvfrom(300)
        listener.sendto(answer(request, kind), peer)
        listener.setblocking(False)
        while True:
            listener.sendto(data, peer)
            try:
                request, peer = listener.recvfrom(300)
            except BlockingIOError:
                continue
            listener.sendto(answer(request, kind), peer)
while True:
    peer, _ = listener.accept()
    try:
        while request := peer.recv(300):
            peer.sendall(answer(request, kind))
            while True:
                peer.sendall(data)
    except OSError:
        pass
"""


class SendingProcess:
    """A server in another process that answers once on each connection, and floods it then."""

    def __init__(self, scheme: str, noise: bytes) -> None:
        command = [sys.executable, "-c", SENDING, scheme, noise.hex()]
        self._scheme = scheme
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    def __enter__(self) -> str:
        assert self._process.stdout is not None
        return f"{self._scheme}://127.0.0.1:{self._process.stdout.readline().strip()}"

    def __exit__(self, *_: object) -> None:
        with self._process:
            self._process.kill()


@pytest.mark.parametrize(
    "pattern", [b"\x01\x03\xfa", b"\x01\x10", b"\x01\x2b\x0e", b"\x01\x03\x02", bytes(range(256))]
)
def test_the_framer_of_rtu_costs_little_for_each_byte(pattern: bytes) -> None:
    """Bytes that begin frames at every place; 64 kB must not stop an event loop."""
    framer = framing.RtuFramer("client")
    data = pattern * (65_536 // len(pattern))
    longest = 0.0
    start = time.process_time()
    for at in range(0, len(data), 4096):
        before = time.process_time()
        framer.scan(data[at : at + 4096])
        longest = max(longest, time.process_time() - before)
    assert time.process_time() - start < 0.4  # 1.5 us a byte; it was 8 to 17
    assert longest < 0.2


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
            assert client.read(address) == address
        assert len(locks) == 1
        assert client.client.state is State.CONNECTED
        assert client.client.statistics.lost == 0


@ALL
def test_a_dead_unit_costs_its_timeout_once_in_each_round(kind: str) -> None:
    def nine_live(request: bytes) -> Iterator[bytes]:
        if request[0] != 5:
            time.sleep(0.06)
            yield rtu(request)

    with (
        FakeUnit(nine_live) as unit,
        asking(kind, f"rtu://{unit.path}?baudrate=115200", timeout=0.5) as client,
    ):
        for _ in range(2):
            start = time.monotonic()
            for number in range(1, 11):
                one = client.for_unit(number)
                if number == 5:
                    with pytest.raises(ModbusTimeoutError):
                        one.read(1)
                else:
                    assert one.read(number) == number
            assert time.monotonic() - start < 0.5 + 9 * 0.06 + LATE


@ALL
def test_a_device_that_is_unit_255_to_everybody_is_reached_with_an_option(kind: str) -> None:
    def as_255(request: bytes) -> list[bytes]:
        return [answer(request, "tcp", unit=255)]

    with FakeServer(as_255) as server:
        url = f"tcp://127.0.0.1:{server.port}"
        with (
            asking(kind, url, unit=3) as client,
            pytest.raises(ModbusError, match='accept_unit="any"') as caught,
        ):
            client.read(1)
        assert caught.value.received[6] == 255
        for options, query in (({"accept_unit": "any"}, ""), ({}, "?accept_unit=any")):
            with asking(kind, url + query, unit=3, **options) as client:
                assert [client.read(address) for address in range(5)] == list(range(5))


@ALL
def test_identification_that_leads_in_circles_gives_what_is_there(kind: str) -> None:
    page = bytes.fromhex("2b0e0101ff0003 000141 010142 020143")  # more follows, from object 0 on

    with (
        FakeServer(lambda request: [mbap(request, page)]) as server,
        asking(kind, f"tcp://127.0.0.1:{server.port}") as client,
    ):
        found = client.read_device_identification()
        assert not found.complete
        assert found.objects[0] == b"A"


@ALL
def test_an_exception_with_a_mei_type_behind_it_is_the_exception(kind: str) -> None:
    from libmodbus_py import IllegalDataAddress

    with (
        FakeServer(lambda request: [mbap(request, b"\xab\x02\x0e")]) as server,
        asking(kind, f"tcp://127.0.0.1:{server.port}") as client,
        pytest.raises(IllegalDataAddress),
    ):
        client.read_device_identification()
