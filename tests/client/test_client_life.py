"""
AsyncClient over its life: timeouts, cancellation, connections that come and go.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import logging
import os
import socket
import time
import warnings
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import pytest
from fake import FakeUnit
from scripted import Scripted, Write, answer, echo, ignore, run

from libmodbus_py import (
    Device,
    FrameError,
    InvalidResponse,
    Mapping,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    Server,
    framing,
    pdu,
)
from libmodbus_py.client.asynchronous import AsyncClient
from libmodbus_py.client.reconnecting import State
from libmodbus_py.testing.wires import SerialWire

REQUEST = pdu.ReadHoldingRegisters(5, 1)


@contextlib.contextmanager
def refusing() -> Iterator[socket.socket]:
    """A port that refuses connections, and that nobody else can take."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound


def url_of(bound: socket.socket) -> str:
    return f"tcp://127.0.0.1:{bound.getsockname()[1]}"


def after(seconds: float) -> Callable[[bytes, Write], None]:
    """Answer late."""

    def on_request(request: bytes, write: Write) -> None:
        asyncio.get_running_loop().call_later(seconds, write, answer(request))

    return on_request


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(5):
        while not condition():
            await asyncio.sleep(0.001)


# --- timeouts -----------------------------------------------------------------------------


def test_each_request_has_its_own_timeout_and_late_answers_are_dropped() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.4)).serving() as server,
            AsyncClient(server.url, timeout=0.1, timeouts_before_reconnect=100) as plc,
        ):
            start = time.monotonic()
            results = await plc.execute_many([REQUEST] * 16, return_exceptions=True)
            assert 0.1 <= time.monotonic() - start < 0.4
            assert {type(each) for each in results} == {ModbusTimeoutError}
            assert results[3].sent == server.requests[3]
            assert "no answer within 0.1 s" in str(results[3])
            server.on_request = echo
            assert await plc.read_holding_registers(6, 1) == [6]
            await until(lambda: plc.late_answers == 16)
            assert await plc.read_holding_registers(7, 1) == [7]
            assert plc.statistics.timeouts == 16
            assert (plc.statistics.connects, server.connections) == (1, 1)

    run(main())


def test_timeouts_count_from_the_slot_not_from_the_queue() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.1)).serving() as server,
            AsyncClient(server.url, timeout=0.4, max_in_flight=1) as plc,
        ):
            assert await plc.execute_many([REQUEST] * 6) == [[5]] * 6

    run(main())


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp"])
def test_trickling_bytes_extend_no_timeout(scheme: str) -> None:
    whole = b"\0\1\0\0\0\xfe" if scheme == "tcp" else b"\1\3\xfa"

    async def main() -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            port = listener.getsockname()[1]
            async with AsyncClient(f"{scheme}://127.0.0.1:{port}", timeout=0.2) as plc:
                with listener.accept()[0] as peer:
                    start = time.monotonic()
                    asking = asyncio.create_task(plc.execute(REQUEST))
                    await until(lambda: plc.statistics.requests)
                    for byte in whole + bytes(100):
                        peer.send(bytes([byte]))
                        await asyncio.sleep(0.01)
                        if asking.done():
                            break
                    assert time.monotonic() - start < 0.6
                    assert isinstance(asking.exception(), ModbusTimeoutError)

    run(main())


def test_half_an_answer_is_shown_and_does_not_spoil_the_next() -> None:
    async def main() -> None:
        async with (
            Scripted(lambda request, write: write(answer(request)[:-1])).serving() as server,
            AsyncClient(server.url, timeout=0.1) as plc,
        ):
            with pytest.raises(ModbusTimeoutError, match="no complete answer") as caught:
                await plc.execute(REQUEST)
            assert caught.value.received == answer(server.requests[0])[:-1]
            server.on_request = echo
            assert await plc.read_holding_registers(6, 1) == [6]
            assert server.connections == 2

    run(main())


def test_timeout_can_be_changed_while_somebody_waits() -> None:
    async def main() -> None:
        async with Scripted(ignore).serving() as server, AsyncClient(server.url, timeout=9) as plc:
            waiting = asyncio.create_task(plc.execute(REQUEST))
            await until(lambda: server.requests)
            plc.timeout = 0.05
            with pytest.raises(ModbusTimeoutError):
                await waiting
            assert plc.timeout == 0.05

    run(main())


def test_connection_that_stays_dumb_is_made_anew() -> None:
    async def main() -> None:
        async with (
            Scripted(ignore).serving() as server,
            AsyncClient(server.url, timeout=0.03, timeouts_before_reconnect=3) as plc,
        ):
            for _ in range(2):
                with pytest.raises(ModbusTimeoutError):
                    await plc.execute(REQUEST)
            server.on_request = echo
            await plc.execute(REQUEST)  # these two timeouts do not count any more
            server.on_request = ignore
            for _ in range(3):
                with pytest.raises(ModbusTimeoutError):
                    await plc.execute(REQUEST)
            assert server.connections == 1
            server.on_request = echo
            assert await plc.execute(REQUEST) == [5]
            assert server.connections == 2

    run(main())


# --- cancellation ---------------------------------------------------------------------------


def test_cancelled_while_it_waits_for_its_answer() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.2)).serving() as server,
            AsyncClient(server.url, max_in_flight=2) as plc,
        ):
            for _ in range(3):
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(0.02):
                        await plc.read_holding_registers(1, 1)
                with pytest.raises(TimeoutError):
                    await asyncio.wait_for(plc.execute_many([REQUEST] * 9), 0.02)
                assert await plc.read_holding_registers(2, 1) == [2]
            assert plc.late_answers == 9
            assert (server.connections, plc.statistics.timeouts) == (1, 0)
            assert len(server.requests) == 12

    run(main())


def test_cancelled_while_it_waits_for_a_slot() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.05)).serving() as server,
            AsyncClient(server.url, max_in_flight=1) as plc,
        ):
            first = asyncio.create_task(plc.read_holding_registers(1, 1))
            second = asyncio.create_task(plc.read_holding_registers(2, 1))
            third = asyncio.create_task(plc.read_holding_registers(3, 1))
            await until(lambda: server.requests)
            second.cancel()
            assert [await first, await third] == [[1], [3]]
            assert second.cancelled()
            assert [request[9] for request in server.requests] == [1, 3]

    run(main())


def test_cancelled_while_it_waits_for_the_connection() -> None:
    async def main() -> None:
        async with (
            Scripted(echo).serving() as server,
            contextlib.aclosing(Closing(AsyncClient(server.url))) as closing,
        ):
            plc = closing.client
            waiting = [asyncio.create_task(plc.execute(REQUEST)) for _ in range(3)]
            joining = asyncio.create_task(plc.connect())
            await asyncio.sleep(0)
            assert plc.state is State.CONNECTING
            waiting[0].cancel()
            waiting[2].cancel()
            joining.cancel()
            assert await waiting[1] == [5]
            await asyncio.sleep(0.02)
            assert len(server.requests) == 1

    run(main())


class Closing:
    """Close a client at the end of a block without having connected it at its begin."""

    def __init__(self, client: AsyncClient) -> None:
        self.client = client

    async def aclose(self) -> None:
        await self.client.close()


@pytest.mark.parametrize("options", [{"request_spacing": 0.2}, {"connect_delay": 0.2}])
def test_cancelled_while_it_must_not_start_yet(options: dict[str, float]) -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server, AsyncClient(server.url, **options) as plc:  # type: ignore[arg-type]
            if "request_spacing" in options:
                await plc.read_holding_registers(0, 1)
            waiting = asyncio.create_task(plc.read_holding_registers(1, 1))
            await asyncio.sleep(0.02)
            waiting.cancel()
            assert await plc.read_holding_registers(2, 1) == [2]
            assert 1 not in [request[9] for request in server.requests]

    run(main())


def test_cancelled_at_any_moment_leaves_a_client_that_works() -> None:
    async def main() -> None:
        async with (
            Scripted(after(0.002)).serving() as server,
            AsyncClient(server.url, max_in_flight=3) as plc,
        ):
            for turn in range(60):
                tasks = [asyncio.create_task(plc.read_holding_registers(n, 1)) for n in range(6)]
                for _ in range(turn % 12):
                    await asyncio.sleep(0)
                tasks[turn % 6].cancel()
                results = await asyncio.gather(*tasks, return_exceptions=True)
                for number, result in enumerate(results):
                    is_cancelled = isinstance(result, asyncio.CancelledError)
                    assert result == [number] or (number == turn % 6 and is_cancelled)
            assert server.connections == 1

    run(main())


# --- connections that come and go -------------------------------------------------------------


def test_lost_connection_fails_all_in_flight_and_the_next_request_connects() -> None:
    async def main() -> None:
        server = Scripted(ignore)
        async with server.serving(), AsyncClient(server.url) as plc:
            waiting = [asyncio.create_task(plc.execute(REQUEST)) for _ in range(16)]
            await until(lambda: len(server.requests) == 16)
            start = time.monotonic()
            server.drop_all()
            results = await asyncio.gather(*waiting, return_exceptions=True)
            assert time.monotonic() - start < 0.5
            assert {type(each) for each in results} == {ModbusConnectionError}
            assert {each.errno for each in results} == {errno.ECONNRESET}  # type: ignore[union-attr]
            assert len({id(each) for each in results}) == 16
            assert [each.sent for each in results] == server.requests  # type: ignore[union-attr]
            server.on_request = echo
            assert await plc.execute(REQUEST) == [5]
            assert plc.statistics.lost == 1
            assert plc.statistics.connects == 2

    run(main())


def test_connection_closed_while_nobody_asks_harms_nobody() -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server, AsyncClient(server.url) as plc:
            for turn in range(1, 4):
                assert await plc.execute(REQUEST) == [5]
                assert server.connections == turn
                for writer in server.writers:  # at once, which abort() does not
                    writer.get_extra_info("socket").shutdown(socket.SHUT_RDWR)
                server.writers.clear()
                if turn == 2:
                    await asyncio.sleep(0.02)  # else the news has not been read yet

    run(main())


def test_batch_goes_on_over_a_new_connection_if_it_may() -> None:
    def third_closes(request: bytes, write: Write) -> None:
        if len(server.requests) == 3:
            server.drop_all()
        else:
            write(answer(request))

    server = Scripted(third_closes)

    async def main() -> None:
        async with server.serving(), AsyncClient(server.url, max_in_flight=1) as plc:
            results = await plc.execute_many([REQUEST] * 6, return_exceptions=True)
            assert [type(each) for each in results].count(ModbusConnectionError) == 1
            assert results.count([5]) == 5
            assert server.connections == 2

    run(main())


def test_attempts_are_shared_and_back_off() -> None:
    attempts: list[float] = []

    def note(state: State, error: ModbusError | None) -> None:
        if state is State.CONNECTING:
            attempts.append(time.monotonic())

    async def main() -> None:
        plc = AsyncClient(url_of(port), timeout=0.3, on_state=note)
        results = await asyncio.gather(
            *(plc.execute(REQUEST) for _ in range(10)), plc.connect(), return_exceptions=True
        )
        assert len(attempts) == 1
        assert {type(each) for each in results} == {ModbusConnectionError}
        assert {each.errno for each in results} == {errno.ECONNREFUSED}  # type: ignore[union-attr]
        assert all(each.__cause__ for each in results)  # type: ignore[union-attr]
        asked, end = 0, time.monotonic() + 1
        while time.monotonic() < end:
            with pytest.raises(ModbusConnectionError) as caught:
                await plc.execute(REQUEST)
            assert caught.value.errno == errno.ECONNREFUSED
            asked += 1
            if "next attempt in" in str(caught.value):
                await asyncio.sleep(0.01)
        gaps = [second - first for first, second in pairwise(attempts)]
        assert 3 <= len(attempts) <= 5
        assert asked > len(attempts)
        for gap, pause in zip(gaps, (0.1, 0.2, 0.4), strict=False):
            assert gap >= 0.8 * pause
        assert plc.statistics.failed_connects == len(attempts)
        await plc.close()

    with refusing() as port:
        run(main())


def test_an_answer_ends_the_backoff() -> None:
    attempts: list[float] = []

    def note(state: State, error: ModbusError | None) -> None:
        if state is State.CONNECTING:
            attempts.append(time.monotonic())

    async def main() -> None:
        server = Scripted(echo)
        with refusing() as port:
            plc = AsyncClient(url_of(port), timeout=1, on_state=note)
            for _ in range(3):
                with pytest.raises(ModbusConnectionError):
                    await plc.execute(REQUEST)
            async with server.serving(port):
                assert await plc.execute(REQUEST) == [5]
        for _ in range(2):
            with pytest.raises(ModbusConnectionError):
                await plc.execute(REQUEST)
        assert attempts[3] - attempts[2] >= 0.32
        assert len(attempts) == 6  # else the last would have failed without one
        await plc.close()

    run(main())


def test_request_waits_for_the_next_attempt_if_it_has_time() -> None:
    async def main() -> None:
        with refusing() as port:
            plc = AsyncClient(url_of(port), timeout=1)
            with pytest.raises(ModbusConnectionError):
                await plc.connect()
            async with Scripted(echo).serving(port):
                assert await asyncio.gather(*(plc.execute(REQUEST) for _ in range(5))) == [[5]] * 5
                assert (plc.statistics.failed_connects, plc.statistics.connects) == (1, 1)
                await plc.close()

    run(main())


def test_server_that_hangs_up_at_once_is_not_hammered() -> None:
    async def main() -> None:
        async with (
            Scripted(lambda request, write: server.drop_all()).serving() as server,
            AsyncClient(server.url, timeout=0.2) as plc,
        ):
            end = time.monotonic() + 0.6
            while time.monotonic() < end:
                with pytest.raises(ModbusConnectionError):
                    await plc.execute(REQUEST)
                await asyncio.sleep(0.001)
            assert server.connections <= 5

    run(main())


@contextlib.contextmanager
def dead() -> Iterator[socket.socket]:
    """A port that does not answer at all, as a dead host: its backlog is full."""
    with socket.socket() as listener, contextlib.ExitStack() as stack:
        listener.bind(("127.0.0.1", 0))
        listener.listen(0)
        for _ in range(3):
            filler = stack.enter_context(socket.socket())
            filler.setblocking(False)
            filler.connect_ex(listener.getsockname())
        yield listener


def test_connecting_takes_no_longer_than_the_timeout() -> None:
    async def main() -> None:
        with dead() as port:
            plc = AsyncClient(url_of(port), timeout=0.2)
            for attempt in (plc.connect, lambda: plc.execute(REQUEST)):
                start = time.monotonic()
                with pytest.raises(ModbusConnectionError) as caught:
                    await attempt()
                assert time.monotonic() - start < 0.6
                assert caught.value.errno == errno.ETIMEDOUT
            await plc.close()

    run(main())


def test_a_dead_address_leaves_time_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server:
            with dead() as port:
                places = [port.getsockname(), ("127.0.0.1", server.port)]
                found = [(socket.AF_INET, socket.SOCK_STREAM, 6, "", place) for place in places]
                monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
                async with AsyncClient("tcp://two-addresses.invalid", timeout=0.4) as plc:
                    assert await plc.execute(REQUEST) == [5]

    run(main())


@pytest.mark.parametrize("host", ["localhost", "[::1]", "127.0.0.1"])
def test_every_address_of_a_name_is_tried(host: str) -> None:
    async def main() -> None:
        address = "::1" if host == "[::1]" else "127.0.0.1"
        server = await asyncio.start_server(lambda reader, writer: writer.close(), address, 0)
        port = server.sockets[0].getsockname()[1]
        async with AsyncClient(f"tcp://{host}:{port}") as plc:
            assert plc.state is State.CONNECTED
            await asyncio.sleep(0.01)
        server.close()

    run(main())


def test_states_are_told_and_a_callback_that_fails_harms_nobody(
    caplog: pytest.LogCaptureFixture,
) -> None:
    seen: list[tuple[State, type[ModbusError] | None]] = []

    def note(state: State, error: ModbusError | None) -> None:
        seen.append((state, error and type(error)))  # type: ignore[arg-type]
        raise ZeroDivisionError

    async def main() -> None:
        server = Scripted(lambda request, write: server.drop_all())
        async with server.serving():
            plc = AsyncClient(server.url, on_state=note)
            assert plc.state is State.DISCONNECTED
            async with plc:
                assert plc.state is State.CONNECTED
                with pytest.raises(ModbusConnectionError):
                    await plc.execute(REQUEST)
            assert plc.state is State.CLOSED

    with caplog.at_level(logging.ERROR):
        run(main())
    assert seen == [
        (State.CONNECTING, None),
        (State.CONNECTED, None),
        (State.DISCONNECTED, ModbusConnectionError),
        (State.CLOSED, None),
    ]
    assert len(caplog.records) == caplog.text.count("failed") == 4


def test_statistics_count_what_happened() -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server, AsyncClient(server.url) as plc:
            assert plc.statistics.last_success is None
            before = time.monotonic()
            await plc.execute_many([REQUEST] * 20)
            assert (plc.statistics.requests, plc.statistics.responses) == (20, 20)
            assert plc.statistics.last_success is not None
            assert plc.statistics.last_success >= before
            assert plc.for_unit(2).statistics is plc.statistics

    run(main())


def test_spacing_and_delay_are_kept() -> None:
    came: list[float] = []

    def note(request: bytes, write: Write) -> None:
        came.append(time.monotonic())
        write(answer(request))

    async def main() -> None:
        async with Scripted(note).serving() as server:
            plc = AsyncClient(server.url, request_spacing=0.03, connect_delay=0.1, timeout=0.09)
            await plc.connect()
            connected = time.monotonic()
            mixed = [plc.execute(REQUEST), plc.execute_many([REQUEST] * 4), plc.execute(REQUEST)]
            await asyncio.gather(*mixed)
            await plc.close()
        assert came[0] - connected >= 0.09
        gaps = [second - first for first, second in pairwise(came)]
        assert len(gaps) == 5
        assert sum(gaps) >= 5 * 0.03 - 0.005

    run(main())


def test_tcp_options_are_set() -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server:
            for keepalive in (45, None):
                async with AsyncClient(server.url, keepalive=keepalive) as plc:
                    descriptor = plc._driver._port.descriptor
                    with socket.socket(fileno=os.dup(descriptor)) as connection:

                        def get(level: int, option: int) -> int:
                            return connection.getsockopt(level, option)

                        assert get(socket.IPPROTO_TCP, socket.TCP_NODELAY)
                        assert get(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == (keepalive == 45)
                        if keepalive:
                            assert get(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE) == keepalive

    run(main())


# --- the end -------------------------------------------------------------------------------------


def test_close_fails_what_is_in_flight_at_once_and_is_final() -> None:
    async def main() -> None:
        async with Scripted(ignore).serving() as server:
            plc = AsyncClient(server.url, timeout=9, max_in_flight=2)
            tasks = [asyncio.create_task(plc.execute(REQUEST)) for _ in range(5)]
            await until(lambda: len(server.requests) == 2)
            start = time.monotonic()
            await asyncio.gather(plc.close(), plc.close())
            results = await asyncio.gather(*tasks, return_exceptions=True)
            assert time.monotonic() - start < 1
            assert all(isinstance(each, ModbusConnectionError) for each in results)
            await plc.close()
            assert plc.closed
            for ask in (plc.connect, lambda: plc.execute(REQUEST)):
                with pytest.raises(ModbusConnectionError, match="closed"):
                    await ask()
            results = await plc.execute_many([REQUEST] * 3, return_exceptions=True)
            assert [type(each) for each in results] == [ModbusConnectionError] * 3

    run(main())


def test_close_while_connecting() -> None:
    async def main() -> None:
        async with Scripted(echo).serving() as server:
            for turns in range(6):
                plc = AsyncClient(server.url)
                waiting = asyncio.create_task(plc.execute(REQUEST))
                for _ in range(turns):
                    await asyncio.sleep(0)
                await plc.close()
                with contextlib.suppress(ModbusConnectionError):
                    await waiting

    run(main())


def test_another_event_loop_is_refused_in_words() -> None:
    plc = AsyncClient("tcp://no-such-host.invalid")

    async def use() -> None:
        with contextlib.suppress(ModbusConnectionError):
            await plc.execute(REQUEST)

    run(use())
    for ask in (plc.connect, plc.close, lambda: plc.execute(REQUEST)):

        async def main(ask: Callable[[], Any] = ask) -> None:
            with pytest.raises(RuntimeError, match="another event loop"):
                await ask()

        run(main())
    with pytest.raises(RuntimeError, match="no running event loop"):
        plc.connect().send(None)


def test_no_descriptor_is_left_behind() -> None:
    async def use(url: str) -> None:
        async with AsyncClient(url) as plc:
            await plc.read_coils(0, 1)

    async def fail(plc: AsyncClient) -> None:
        with contextlib.suppress(ModbusError):
            await plc.connect()
        await plc.close()

    async def main() -> None:
        device = Device(Mapping(coils=8))
        with SerialWire() as wire, refusing() as port:
            async with Server(device).serving(
                "tcp://127.0.0.1:0", "udp://127.0.0.1:0", f"rtu://{wire.server}"
            ) as running:
                urls = [*running.urls[:2], f"rtu://{wire.client}"]
                bad = (url_of(port), "rtu:///dev/null", "udp://[::1%9]")
                before = 0
                for turn in range(200):
                    await use(urls[0])
                    if turn % 20 == 0:
                        for url in urls:
                            await use(url)
                        for url in bad:
                            await fail(AsyncClient(url, timeout=0.2))
                    if turn == 20:
                        await asyncio.sleep(0.02)
                        before = len(os.listdir("/proc/self/fd"))
                await asyncio.sleep(0.02)
                assert len(os.listdir("/proc/self/fd")) <= before

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run(main())
        gc.collect()


# --- UDP ------------------------------------------------------------------------------------------


class Datagrams(asyncio.DatagramProtocol):
    def __init__(self, reply: Callable[[bytes], list[bytes]]) -> None:
        self.reply = reply

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self.transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        for each in self.reply(data):
            self.transport.sendto(each, addr)  # type: ignore[attr-defined]


def test_udp_drops_what_is_no_answer_and_matches_by_id() -> None:
    held: list[bytes] = []

    def reply(data: bytes) -> list[bytes]:
        held.append(data)
        if len(held) < 8:
            return [b"", b"junk", answer(data)[:-1], answer(data) + b"x"]
        return [answer(each) for each in reversed(held)] * 2

    async def main() -> None:
        loop = asyncio.get_running_loop()
        transport, _ = await loop.create_datagram_endpoint(
            lambda: Datagrams(reply), ("127.0.0.1", 0)
        )
        port = transport.get_extra_info("sockname")[1]
        async with AsyncClient(f"udp://127.0.0.1:{port}") as plc:
            asked = [plc.read_holding_registers(address, 1) for address in range(8)]
            assert await asyncio.gather(*asked) == [[address] for address in range(8)]
            await until(lambda: plc.late_answers == 8)
            assert plc.statistics.invalid >= 21
        transport.close()

    run(main())


def test_refused_udp_port_is_a_connection_error() -> None:
    async def main() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
        async with AsyncClient(f"udp://127.0.0.1:{port}", timeout=5) as plc:
            with pytest.raises(ModbusConnectionError) as caught:
                await plc.execute(REQUEST)
            assert caught.value.errno == errno.ECONNREFUSED

    run(main())


# --- serial lines ----------------------------------------------------------------------------


RTU = framing.RtuFramer("server")


def rtu(value: int, unit: int = 1) -> bytes:
    return RTU.encode(framing.Frame(unit, b"\x03\x02" + value.to_bytes(2, "big")))


def good(request: bytes) -> list[bytes]:
    return [rtu(int.from_bytes(request[2:4], "big"))]


@pytest.mark.parametrize(
    ("bad", "error"),
    [
        ([], ModbusTimeoutError),
        ([b"\x01\x03\x02\x00"], ModbusTimeoutError),
        ([rtu(5)[:-1] + b"\x00"], FrameError),
        ([rtu(5, unit=9)], InvalidResponse),
        ([RTU.encode(framing.Frame(1, b"\x04\x02\x00\x05"))], InvalidResponse),
    ],
)
def test_after_a_failure_the_line_must_be_silent(
    bad: list[bytes], error: type[ModbusError]
) -> None:
    timeout = 0.3

    async def main() -> None:
        with FakeUnit(lambda request: bad, good) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200", timeout=timeout) as plc:
                start = time.monotonic()
                with pytest.raises(error) as caught:
                    await plc.execute(REQUEST)
                failed = time.monotonic()
                assert failed - start < 2 * timeout
                assert caught.value.received == b"".join(bad)
                assert await plc.read_holding_registers(6, 1) == [6]
                assert time.monotonic() - failed >= timeout - 0.01

    run(main())


def test_late_answer_on_a_serial_line_is_not_taken_for_the_next() -> None:
    async def main() -> None:
        with FakeUnit(lambda request: [], good) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200", timeout=0.4) as plc:
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(0.03):
                        await plc.read_holding_registers(5, 1)
                waiting = asyncio.create_task(plc.read_holding_registers(6, 1))
                gone = asyncio.create_task(plc.read_holding_registers(7, 1))
                await asyncio.sleep(0.1)
                late = time.monotonic()
                unit.write(rtu(5))
                gone.cancel()
                assert await waiting == [6]
                assert time.monotonic() - late >= 0.39
                assert plc.late_answers == 1
                assert len(unit.requests) == 2

    run(main())


def test_line_that_does_not_fall_silent_ends_the_wait() -> None:
    async def babble(unit: FakeUnit) -> None:
        while True:
            unit.write(b"\x55")
            await asyncio.sleep(0.01)

    async def main() -> None:
        with FakeUnit(lambda request: [], good) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200", timeout=0.25) as plc:
                with pytest.raises(ModbusTimeoutError):
                    await plc.execute(REQUEST)
                babbling = asyncio.create_task(babble(unit))
                start = time.monotonic()
                with pytest.raises(FrameError, match="does not fall silent") as caught:
                    await plc.execute(REQUEST)
                assert 0.5 <= time.monotonic() - start < 1
                assert set(caught.value.received) == {0x55}
                babbling.cancel()
                assert await plc.execute(REQUEST) == [5]

    run(main())


def test_noise_and_other_units_before_the_answer_do_not_end_the_wait() -> None:
    async def main() -> None:
        with FakeUnit(lambda request: [b"\xff\xff" + rtu(9, unit=9) + rtu(5)]) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200") as plc:
                unit.write(rtu(77))  # nobody asked for it
                assert await plc.execute(REQUEST) == [5]

    run(main())


def test_broadcast_waits_for_no_answer_and_reads_are_refused() -> None:
    async def main() -> None:
        with FakeUnit(lambda request: [], lambda request: [], good) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200", turnaround=0.1) as plc:
                everyone = plc.for_unit(0)
                start = time.monotonic()
                await everyone.write_register(1, 2)
                assert 0.1 <= time.monotonic() - start < 0.9
                with pytest.raises(ValueError, match="broadcast"):
                    await everyone.read_coils(0, 1)
                with pytest.raises(ValueError, match=r"requests\[1\].*broadcast"):
                    await everyone.execute_many([pdu.WriteCoil(0, True), REQUEST])
                with pytest.raises(TimeoutError):
                    async with asyncio.timeout(0.03):
                        await everyone.write_register(1, 3)
                assert await plc.execute(REQUEST) == [5]
                assert time.monotonic() - start >= 0.2
                assert unit.requests[0][:6] == bytes.fromhex("000600010002")

    run(main())


def test_line_is_silent_before_each_request() -> None:
    went: list[float] = []
    came: list[float] = []

    def reply(request: bytes) -> list[bytes]:
        came.append(time.monotonic())
        went.append(time.monotonic())
        return good(request)

    async def main() -> None:
        with FakeUnit(reply) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200&silence=0.03") as plc:
                assert await plc.execute_many([REQUEST] * 5) == [[5]] * 5
        gaps = [later - earlier for later, earlier in zip(came[1:], went, strict=False)]
        assert min(gaps) >= 0.03

    run(main())


@pytest.mark.parametrize("query", ["rs485=rts-up&rts_delay=0.05", "echo=1"])
def test_direction_control_and_echo(query: str) -> None:
    async def main() -> None:
        def reply(request: bytes) -> list[bytes]:
            return ([request] if "echo" in query else []) + good(request)

        turns = 0

        async def count() -> None:
            nonlocal turns
            while True:
                await asyncio.sleep(0.001)
                turns += 1

        with FakeUnit(reply) as unit:
            async with AsyncClient(f"rtu://{unit.path}?baudrate=115200&{query}") as plc:
                counting = asyncio.create_task(count())
                assert await plc.execute(REQUEST) == [5]
                assert await plc.read_holding_registers(6, 1) == [6]
                counting.cancel()
                assert turns > 20 or "echo" in query  # the loop went on meanwhile

    run(main())


def test_unplugged_port_is_a_connection_error_and_is_opened_again(tmp_path: Any) -> None:
    async def main() -> None:
        path = tmp_path / "port"
        device = Device(Mapping(holding_registers=8))
        with SerialWire() as wire:
            path.symlink_to(wire.client)
            plc = AsyncClient(f"rtu://{path}?baudrate=115200", timeout=0.5)
            waiting = asyncio.create_task(plc.execute(REQUEST))
            await until(lambda: plc.statistics.requests)
            await asyncio.to_thread(wire.unplug)
            with pytest.raises(ModbusConnectionError) as caught:
                await waiting
            assert caught.value.errno == errno.EIO
        with SerialWire() as wire, Server(device).background(f"rtu://{wire.server}"):
            path.unlink()
            path.symlink_to(wire.client)
            assert await plc.execute(REQUEST) == [0]
            await plc.close()

    run(main())
