"""Devices that do what the specification does not say, each with the option that it needs."""

from typing import Any

import pytest

from libmodbus_py import (
    Client,
    InvalidResponse,
    ModbusConnectionError,
    ModbusTimeoutError,
    State,
    pdu,
)
from tests.support.clients import World, read
from tests.support.driver import rtu
from tests.support.peers import Write, answer, ignore, mbap
from tests.support.reads import on_read, on_read_at

LINES = ["rtu", "rtu+tcp", "ascii", "ascii+tcp"]


@pytest.mark.parametrize("scheme", LINES)
def test_unit_0_answers_reads_and_writes_if_broadcast_is_false(world: World, scheme: str) -> None:
    """pymodbus#2378: the only device of a line answers as unit 0, to tell its address."""
    peer = world.peer(scheme, on_read_at(scheme))
    with world.connect(peer.url, unit=0, broadcast=False, timeout=0.5) as plc:
        assert read(plc, 7) == 7
        assert plc.read_many({"it": ("holding_registers", 7)}) == {"it": [7]}
        peer.on_request = ignore
        with pytest.raises(ModbusTimeoutError):
            plc.write_register(0, 1)


@pytest.mark.parametrize("scheme", LINES)
def test_a_raw_request_to_unit_0_waits_for_its_answer(world: World, scheme: str) -> None:
    with world.client_of(scheme, on_read_at(scheme), unit=0) as plc:
        assert plc.execute(pdu.RawRequest(3, b"\0\7\0\1")) == b"\2\0\7"
        with pytest.raises(ValueError, match="is not a write; broadcast=False, if a device answe"):
            read(plc, 7)
        with world.lasting(0.1, 0.01):
            plc.write_register(0, 1)


@pytest.mark.parametrize("scheme", [*LINES, "tcp", "udp"])
def test_any_unit_may_answer(world: World, scheme: str) -> None:
    def on_request(request: bytes, write: Write) -> None:
        write(answer(request, scheme, 9))

    peer = world.peer(scheme, on_request)
    with world.connect(peer.url, accept_unit="any") as plc:
        assert [read(plc, at) for at in range(3)] == [0, 1, 2]
    with (
        world.connect(peer.url, timeout=0.5) as plc,
        pytest.raises(InvalidResponse, match="unit 9 answered"),
    ):
        read(plc, 7)


@pytest.mark.parametrize("scheme", ["tcp", "udp", "tls"])
def test_any_id_is_accepted_with_ids_ignore(world: World, scheme: str) -> None:
    def on_request(request: bytes, write: Write) -> None:
        write(mbap(request, b"\3\2" + request[8:10], transaction=0))

    peer = world.peer(scheme, on_request)
    with (
        world.connect(peer.url, timeout=0.5) as plc,
        pytest.raises(ModbusTimeoutError, match='id 0, not 1; ids="ignore" would take it'),
    ):
        read(plc, 7)
    with world.connect(f"{peer.url}{'&' if '?' in peer.url else '?'}ids=ignore") as plc:
        assert [read(plc, at) for at in range(5)] == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("scheme", ["tcp", "udp"])
def test_no_late_answer_is_accepted_with_ids_ignore(world: World, scheme: str) -> None:
    def on_request(request: bytes, write: Write) -> None:
        late = 0.6 if len(peer.requests) % 3 == 1 else 0.1
        write(mbap(request, b"\3\2" + request[8:10], transaction=0), after=late)

    peer = world.peer(scheme, on_request)
    values: list[Any] = []
    with world.connect(peer.url, timeout=0.5, ids="ignore") as plc:
        for at in range(12):
            try:
                values.append(read(plc, at) == at)
            except ModbusTimeoutError:
                values.append(None)
    assert values == [None, True, True] * 4


def test_no_source_has_a_port_with_ids_ignore_over_udp() -> None:
    """A late answer would reach the next socket, which has the same port."""
    source = "127.0.0.1:40000"
    with pytest.raises(ValueError, match='source must have no port with ids="ignore" on udp'):
        Client(f"udp://127.0.0.1?source={source}", ids="ignore")
    for url, options in {
        "udp://127.0.0.1": {"source": "127.0.0.1", "ids": "ignore"},
        "udp://127.0.0.2": {"source": source},
        "tcp://127.0.0.1": {"source": source, "ids": "ignore"},  # a reset ends the connection
    }.items():
        Client(url, **options).close()  # type: ignore[arg-type]


def closing(after: float, scheme: str) -> Any:
    """Return a function that answers each read, and closes the connection so many seconds later."""

    def on_request(request: bytes, write: Write) -> None:
        write(answer(request, scheme))
        write(None, after=after)

    return on_request


@pytest.mark.parametrize("scheme", ["tcp", "rtu+tcp", "ascii+tcp"])
@pytest.mark.parametrize("after", [0.0, 0.0001, 0.05])
def test_a_device_that_closes_after_each_answer_is_read_without_retries(
    world: World, scheme: str, after: float
) -> None:
    """The connection ends during the next request, without one, and during HOLD."""
    peer = world.peer(scheme, closing(after, scheme))
    with world.connect(peer.url, timeout=1) as plc:
        for at in range(30):
            assert read(plc, at) == at
            world.sleep(0.01 * (at % 3))


def test_a_read_is_sent_once_more_within_its_time(world: World) -> None:
    peer = world.peer("tcp", on_read)
    with world.connect(peer.url, timeout=1) as plc:
        assert read(plc, 1) == 1
        peer.on_request = lambda request, write: write(None, after=0.4)
        with world.lasting(0.8), pytest.raises(ModbusConnectionError, match="closed by the other"):
            read(plc, 2)
        peer.on_request = on_read
        assert read(plc, 3) == 3

        def close(request: bytes, write: Write) -> None:
            write(None, after=0.4)
            peer.on_request = ignore

        peer.on_request = close
        with world.lasting(1.0), pytest.raises(ModbusTimeoutError):
            read(plc, 4)
    assert [int.from_bytes(request[8:10], "big") for request in peer.requests] == [1, 2, 2, 3, 4, 4]


@pytest.mark.parametrize("case", ["a write", "no answer before", "half an answer"])
def test_requests_that_may_have_been_executed_are_not_repeated(world: World, case: str) -> None:
    peer = world.peer("tcp", on_read)

    def close(request: bytes, write: Write) -> None:
        if case == "half an answer":
            write(answer(request, "tcp")[:9])
        write(None)

    with world.connect(peer.url, timeout=1) as plc:
        if case != "no answer before":
            read(plc, 1)
        peer.on_request = close
        before = len(peer.requests)
        with pytest.raises(ModbusConnectionError):
            plc.write_register(0, 7) if case == "a write" else read(plc, 2)
        assert len(peer.requests) == before + 1


def test_an_idle_connection_is_closed_and_made_again(world: World) -> None:
    states: list[tuple[State, Any]] = []
    peer = world.peer("tcp", on_read)
    with world.connect(peer.url, idle_close=2, on_state=lambda *state: states.append(state)) as plc:
        for pause, connections in ((1.9, 1), (1.9, 1), (2.1, 1), (0.5, 2), (9.0, 2), (0.0, 3)):
            assert read(plc, 7) == 7
            assert peer.connections == connections
            world.sleep(pause)
        assert (plc.statistics.connects, plc.statistics.lost) == (3, 0)
    assert states.count((State.DISCONNECTED, None)) == 2  # which is no failure


def test_watch_closes_idle_connections_between_its_polls(world: World) -> None:
    peer = world.peer("tcp", on_read)
    times: list[float] = []

    def note(state: State, error: Any) -> None:
        if state is State.DISCONNECTED:
            times.append(round(world.now - started, 2))

    with world.connect(peer.url, idle_close=2, on_state=note) as plc:
        started = world.now
        polls = plc.watch([("holding_registers", 7)], every=10)
        assert [next(polls) for _ in range(3)] == [[[7]]] * 3
    assert times == [2.0, 12.0]
    assert peer.connections == 3


def test_an_answer_that_takes_longer_than_idle_close_is_awaited(world: World) -> None:
    def on_request(request: bytes, write: Write) -> None:
        write(answer(request, "tcp"), after=3)

    peer = world.peer("tcp", on_request)
    with world.connect(peer.url, timeout=5, idle_close=0.5) as plc:
        assert read(plc, 7) == 7
    assert peer.connections == 1


@pytest.mark.parametrize("scheme", ["tcp", "tls"])
@pytest.mark.parametrize("heartbeat", [b"\xff", b"\xff\xff"])
def test_heartbeats_between_answers_are_dropped(world: World, scheme, heartbeat) -> None:
    """node-modbus/stream#17: a modem sends FF between the answers of its device."""

    def on_request(request: bytes, write: Write) -> None:
        write(answer(request, scheme) + heartbeat)
        write(heartbeat[:1], after=0.1)

    peer = world.peer(scheme, on_request)
    with world.connect(peer.url) as plc:
        for at in range(5):
            assert read(plc, at) == at
            world.sleep(0.2)
        assert peer.connections == 1
        # While an answer is missing, it may be the beginning of that.
        peer.on_request = lambda request, write: write(heartbeat, after=1.5)
        with pytest.raises(ModbusTimeoutError):
            read(plc, 5)
        world.sleep(1)
        peer.on_request = on_request
        assert read(plc, 6) == 6
        assert peer.connections == 2


@pytest.mark.parametrize("scheme", ["rtu+tcp", "ascii+tcp"])
def test_silence_lasts_from_an_answer_to_the_next_request(world: World, scheme: str) -> None:
    peer = world.peer(scheme, on_read_at(scheme, 0.3))
    with world.connect(f"{peer.url}?silence=0.2") as plc:
        for at in range(6):
            assert read(plc, at) == at
    pauses = [later - sooner for sooner, later in zip(peer.times, peer.times[1:], strict=False)]
    # The first answers on a line are held for longer.
    assert min(pauses) == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize("scheme", ["rtu", "rtu+tcp"])
def test_a_frame_of_another_length_is_shown_and_is_the_answer_to_a_raw_request(
    world: World, scheme: str
) -> None:
    """pymodbus#1542: a frequency inverter sends the byte count in two bytes."""
    frame = rtu("01 03 0002 1781")
    with world.client_of(scheme, lambda request, write: write(frame), timeout=0.5) as plc:
        with pytest.raises(InvalidResponse, match="a response of 5 bytes: 03 00 02 17 81"):
            plc.read_holding_registers(0x7002, 1)
        assert plc.execute(pdu.RawRequest(3, b"\x70\2\0\1")) == b"\0\2\x17\x81"


@pytest.mark.parametrize("scheme", ["rtu", "rtu+tcp"])
def test_bytes_after_the_echo_of_a_write_are_ignored_on_lines(world: World, scheme: str) -> None:
    def on_request(request: bytes, write: Write) -> None:
        write(rtu(f"{request[:-2].hex()} 06"))

    with world.client_of(scheme, on_request, timeout=0.5) as plc:
        plc.write_register(3, 7)
