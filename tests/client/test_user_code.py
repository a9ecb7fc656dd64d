"""Request classes and callbacks that raise, on both clients: only their caller meets it."""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import (
    AsyncClient,
    Client,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
    State,
    pdu,
)
from libmodbus_py.client.sender import Sender
from tests.simulation.scripted import OnRequest, Scripted
from tests.support.cases import each_case
from tests.support.clients import ALL, KINDS, World, asking, making, read
from tests.support.in_loops import run_client
from tests.support.peers import FakeServer, Write, address_of, answer, has_header
from tests.support.reads import on_read
from tests.support.urls import CONNECTING, rules_of

each_scheme = pytest.mark.parametrize("scheme", CONNECTING)


class Mistake(Exception):
    """An exception that a request class raises by mistake."""


def fail(*_: object) -> Any:
    raise Mistake


def with_mistake(name: str) -> pdu.ReadHoldingRegisters:
    """Return a read of register 5 whose class fails in one method or property."""
    at: Any = property(fail) if name in ("repeatable", "expects_response") else fail
    kind: Any = type("Mistaken", (pdu.ReadHoldingRegisters,), {"__slots__": (), name: at})
    request: pdu.ReadHoldingRegisters = kind(5, 1)
    return request


def replying(scheme: str, outcome: str) -> OnRequest:
    """Return a function that answers all reads, and that of register 5 in another way."""
    around = 7 if has_header(scheme) else 1

    def reply(request: bytes, write: Write) -> None:
        if address_of(request, scheme) != b"\x00\x05" or outcome == "answer":
            write(answer(request, scheme))
        elif outcome == "damage":
            good = answer(request, scheme)
            write(good[:around] + bytes([good[around], 1]) + good[around + 2 :])
        elif outcome == "close":
            write(None)

    return reply


def outcome_of(call: Callable[[], object]) -> object:
    """Return the result of a call, or its exception."""
    try:
        return call()
    except Exception as error:
        return error


METHODS = ["encode", "expects_response", "decode_response", "repeatable", "__str__"]


@each_scheme
@each_case(("kind", "name", "outcome"), [
    (kind, name, outcome)
    for kind in KINDS
    for name in METHODS
    for outcome in ("answer", "silence", "damage", "close")
])  # fmt: skip
def test_a_mistake_in_a_class_is_met_by_its_caller(scheme: str, kind, name, outcome) -> None:
    rules = rules_of(scheme)
    if outcome == "close" and (rules.is_serial or rules.is_datagram):
        return
    with making(kind) as world:
        peer = world.peer(scheme, replying(scheme, outcome))
        with world.connect(peer.url, timeout=0.5, retries=1) as client:
            result = outcome_of(lambda: client.execute(with_mistake(name)))
            assert result == [5] or isinstance(result, Mistake | ModbusError), result
            if name in ("encode", "expects_response"):
                assert isinstance(result, Mistake)
                assert peer.requests == []
            assert client.read_holding_registers(7, 1) == [7]
            assert client._driver._connection.in_flight == 0


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("outcome", ["answer", "silence", "close"])
def test_a_mistake_in_a_class_leaves_the_callers_beside_it_alone(name: str, outcome: str) -> None:
    async def use(plc: AsyncClient, _: Scripted) -> None:
        reads = [plc.read_holding_registers(address, 1) for address in (1, 2, 3)]
        *others, mistaken = await asyncio.gather(
            *reads, plc.execute(with_mistake(name)), return_exceptions=True
        )
        assert others == [[1], [2], [3]]
        assert mistaken == [5] or isinstance(mistaken, Mistake | ModbusError)

    run_client(replying("tcp", outcome), use, timeout=0.5, retries=1)


class Broken(logging.Handler):
    """A log handler that fails, as a full disk or a closed connection makes it."""

    def emit(self, record: logging.LogRecord) -> None:
        raise Mistake


@pytest.fixture
def broken_log() -> Iterator[None]:
    """All that the package logs, at any level, meets a handler that fails."""
    logger, handler = logging.getLogger("libmodbus_py"), Broken()
    logger.addHandler(handler)
    logger.setLevel(logging.DEBUG)
    yield
    logger.removeHandler(handler)
    logger.setLevel(logging.NOTSET)


@pytest.mark.usefixtures("broken_log")
@pytest.mark.parametrize("hook", [None, "trace", "on_state", "may_send"])
@each_scheme
def test_a_log_handler_that_fails_fails_no_call(world: World, scheme: str, hook) -> None:
    peer = world.peer(scheme, replying(scheme, "silence"))
    if hook == "may_send" and world.kind != "asyncio":
        return
    options = {hook: fail} if hook else {}
    with world.connect(peer.url, timeout=0.5, **{} if hook == "may_send" else options) as client:
        assert client.read_holding_registers(1, 1) == [1]
        with pytest.raises(ModbusTimeoutError):
            client.read_holding_registers(5, 1)
        assert client.read_holding_registers(2, 1) == [2]
    if hook == "may_send":
        other = world.connect(peer.url, timeout=0.5, **options)
        with pytest.raises(ModbusError, match="may_send"):
            other.read_holding_registers(1, 1)
        other.close()


def test_callbacks_can_read_the_state_that_they_are_called_for(world: World) -> None:
    """A callback that looks at the client sees the state that it is told of."""
    states: list[tuple[State, State]] = []
    counts: list[tuple[str, int]] = []
    clients: list[Any] = []
    peer = world.peer("tcp", replying("tcp", "answer"))

    def on_state(state: State, error: object) -> None:
        states.append((state, clients[0].state))

    def trace(frame: Any) -> None:
        counts.append((frame.direction, clients[0].statistics.requests))

    clients.append(world.connect(peer.url, on_state=on_state, trace=trace))
    with clients[0] as client:
        assert client.read_holding_registers(1, 1) == [1]
    assert [state for state, _ in states] == [State.CONNECTING, State.CONNECTED, State.CLOSED]
    assert all(state is current for state, current in states)
    assert counts == [("sent", 1), ("received", 1)]


def test_a_trace_of_a_request_comes_before_its_answer(world: World) -> None:
    times: list[tuple[str, float]] = []
    peer = world.peer("tcp", lambda request, write: write(answer(request, "tcp"), after=0.3))
    with world.connect(
        peer.url, trace=lambda frame: times.append((frame.direction, world.now))
    ) as client:
        start = world.now
        client.read_holding_registers(1, 1)
    (first, at), (second, then) = times
    assert (first, second) == ("sent", "received")
    assert at - start < 0.1
    assert then - at >= 0.299


def submitting(act: Callable[[AsyncClient, list[Any]], object]) -> list[Any]:
    """Submit two reads, the first with an `on_done` of the test; return the outcomes."""
    outcomes: list[Any] = []

    async def use(plc: AsyncClient, _: Scripted) -> None:
        event = asyncio.Event()
        Sender(plc).submit(1, pdu.ReadHoldingRegisters(1, 1), lambda: act(plc, outcomes))
        second = Sender(plc).submit(1, pdu.ReadHoldingRegisters(2, 1), event.set)
        await event.wait()
        outcomes.append(second.outcome)
        await asyncio.sleep(1)

    run_client(on_read, use)
    return outcomes


def test_an_on_done_that_raises_is_logged(caplog: pytest.LogCaptureFixture) -> None:
    assert submitting(lambda plc, outcomes: fail()) == [[2]]
    assert [record.message for record in caplog.records] == ["on_done failed"]


def test_an_on_done_that_is_a_coroutine_is_an_error(caplog: pytest.LogCaptureFixture) -> None:
    assert submitting(lambda plc, outcomes: asyncio.sleep(0)) == [[2]]
    assert "which nothing awaits" in caplog.text


def test_an_on_done_may_submit() -> None:
    def submit(plc: AsyncClient, outcomes: list[Any]) -> None:
        third = Sender(plc).submit(
            1, pdu.ReadHoldingRegisters(3, 1), lambda: outcomes.append(third.outcome)
        )

    assert submitting(submit) == [[2], [3]]


class Submitting(pdu.ReadHoldingRegisters):
    """A request whose class uses the client while an answer is decoded."""

    __slots__ = ()
    plc: AsyncClient
    told: list[Any]

    def decode_response(self, data: bytes) -> list[int]:
        read = pdu.ReadHoldingRegisters(6, 1)
        submitted = Sender(self.plc).submit(1, read, lambda: self.told.append(submitted.outcome))
        Sender(self.plc).submit(1, read, fail).withdraw()
        return super().decode_response(data)


def test_a_class_may_use_the_client_while_it_decodes() -> None:
    async def use(plc: AsyncClient, _: Scripted) -> None:
        outcomes: list[Any] = []
        kind: Any = type("Own", (Submitting,), {"plc": plc, "told": outcomes, "__slots__": ()})
        results = await asyncio.gather(*(plc.execute(kind(at, 1)) for at in (1, 2, 3)))
        await asyncio.sleep(1)
        assert results == [[1], [2], [3]]
        assert outcomes == [[6], [6], [6]]

    run_client(on_read, use)


def tcp(request: bytes) -> list[bytes]:
    return [answer(request[at : at + 12], "tcp") for at in range(0, len(request), 12)]


class Raised(BaseException):
    """Neither an Exception nor one that an event loop knows."""


@pytest.mark.parametrize("error", [KeyError, MemoryError, KeyboardInterrupt, Raised])
@pytest.mark.parametrize("hook", ["on_state", "trace"])
@pytest.mark.parametrize("at", range(4))
def test_a_callback_that_raises_leaves_a_working_client(at, hook, error) -> None:
    """At its first call, or a later one: connecting, sending, receiving, being lost."""
    calls = iter(range(1000))

    def fail(*_: object) -> None:
        if next(calls) == at:
            raise error

    options: dict[str, Any] = {hook: fail}
    with FakeServer(tcp, None, tcp) as server:
        context = Client(f"tcp://127.0.0.1:{server.port}", **options)
        for address in range(6):
            with contextlib.suppress(error, ModbusConnectionError):
                assert context.read_holding_registers(address, 1) == [address]
        for address in range(3):
            assert context.read_holding_registers(address, 1) == [address]
        assert context.state is State.CONNECTED
        context.close()


@pytest.mark.parametrize("hook", ["on_state", "trace"])
@pytest.mark.parametrize("at", range(3))
def test_a_hook_that_closes_ends_the_request(at: int, hook: str) -> None:
    calls = iter(range(1000))

    def close(*_: object) -> None:
        if next(calls) == at:
            context.close()

    options: dict[str, Any] = {hook: close}
    with FakeServer(tcp) as server:
        context = Client(f"tcp://127.0.0.1:{server.port}", **options)
        with contextlib.suppress(ModbusConnectionError):
            for address in range(3):
                assert context.read_holding_registers(address, 1) == [address]
        context.close()
        with pytest.raises(ModbusConnectionError, match="closed"):
            context.read_holding_registers(1, 1)
    assert context.closed


@pytest.mark.parametrize("hook", ["on_state", "trace"])
def test_a_hook_that_uses_its_client_is_refused(hook: str) -> None:
    errors: list[BaseException] = []

    def ask(*_: object) -> None:
        try:
            context.read_coils(0, 1)
        except (RuntimeError, ModbusConnectionError) as error:
            errors.append(error)

    options: dict[str, Any] = {hook: ask}
    with FakeServer(tcp) as server:
        context = Client(f"tcp://127.0.0.1:{server.port}", **options)
        assert context.read_holding_registers(1, 1) == [1]
        context.close()
    assert isinstance(errors[0], RuntimeError)


@ALL
@pytest.mark.parametrize("data", [b"", bytes(254), "text", None, 7])
def test_a_request_class_that_encodes_invalid_bytes_is_refused(data: Any, kind: str) -> None:
    class Nonsense(pdu.ReadHoldingRegisters):
        def encode(self) -> Any:
            return data

    with (
        FakeServer(tcp) as server,
        asking(kind, f"tcp://127.0.0.1:{server.port}", timeout=0.5) as client,
    ):
        assert read(client, 1) == 1
        for _ in range(3):
            with pytest.raises((TypeError, ValueError)):
                client.execute(Nonsense(1, 1))
            assert read(client, 2) == 2
        assert server.connections == 1
