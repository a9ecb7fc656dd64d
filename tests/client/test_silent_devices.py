"""Devices that do not answer, and connections that are made again."""

from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import (
    GatewayTargetFailedToRespond,
    ModbusConnectionError,
    ModbusTimeoutError,
    Plan,
    Point,
    RegisterMap,
    pdu,
)
from libmodbus_py.client.history import forget_lines
from libmodbus_py.client.reconnecting import Notices, Reconnecting, State
from libmodbus_py.client.statistics import Statistics
from tests.support.cases import each_case
from tests.support.clients import World
from tests.support.peers import Write, address_of, answer, ignore, mbap

ITEMS = {f"p{at}": ("holding_registers", 10 * at, 1) for at in range(6)}

POINTS = RegisterMap([Point(f"p{at}", "holding_registers", 10 * at) for at in range(6)])

READS: list[Callable[[Any], dict[str, Any]]] = [
    lambda plc: plc.read_many(ITEMS, return_exceptions=True),  # type: ignore[no-any-return]
    lambda plc: plc.read_many(Plan(ITEMS), return_exceptions=True),  # type: ignore[no-any-return]
    lambda plc: plc.read_map(POINTS, return_exceptions=True),  # type: ignore[no-any-return]
    lambda plc: next(plc.watch(ITEMS, every=60)),
    lambda plc: next(plc.watch(POINTS, every=60)),
]
"""All that reads several items of a device."""


def silent_about(*addresses: int) -> Callable[[bytes, Write], None]:
    """Return a function that answers reads over TCP with their address, except for some."""

    def on_request(request: bytes, write: Write) -> None:
        if int.from_bytes(address_of(request, "tcp"), "big") not in addresses:
            write(answer(request, "tcp"))

    return on_request


def values(results: dict[str, Any]) -> set[str]:
    return {name for name, value in results.items() if not isinstance(value, Exception)}


@each_case("scheme", ["tcp", "rtu", "rtu+tcp", "udp"])
@each_case("read", READS)
def test_a_silent_device_costs_one_timeout(world: World, scheme, read) -> None:
    forget_lines()
    peer = world.peer(scheme, ignore)
    with world.connect(peer.url, timeout=0.5) as plc:
        before = len(peer.requests)
        with world.lasting(0.5):
            results = read(plc)
        assert len(peer.requests) == before + 1
        assert {*map(type, results.values())} == {ModbusTimeoutError}
        assert str(results["p0"]).endswith("address=0, count=1): no answer within 0.5 s")
        assert str(results["p5"]) == (
            "unit 1, function 3, ReadHoldingRegisters(address=50, count=1): given up after "
            "ReadHoldingRegisters(address=0, count=1): no answer within 0.5 s"
        )
        assert (results["p5"].sent, results["p5"].endpoint) == (b"", plc.url)


def test_repetitions_are_made_of_the_first_request_only(world: World) -> None:
    peer = world.peer("tcp", ignore)
    with world.connect(peer.url, timeout=0.5, retries=2) as plc, world.lasting(1.5):
        plc.read_map(POINTS, return_exceptions=True)
    assert len(peer.requests) == 3


def test_requests_in_flight_together_end_together(world: World) -> None:
    peer = world.peer("tcp", ignore)
    with world.connect(peer.url, timeout=0.5, max_in_flight=3) as plc:
        with world.lasting(0.5):
            results = plc.read_map(POINTS, return_exceptions=True)
        assert not values(results)
        assert len(peer.requests) == 3
        assert results["p2"].sent
        peer.on_request = silent_about()
        assert values(plc.read_map(POINTS, return_exceptions=True)) == {*ITEMS}


def test_a_gateway_that_answers_for_a_silent_unit_is_asked_once(world: World) -> None:
    def refuse(request: bytes, write: Write) -> None:
        write(mbap(request, b"\x83\x0b"), after=0.3)

    peer = world.peer("tcp", refuse)
    with world.connect(peer.url) as plc, world.lasting(0.3):
        results = plc.read_map(POINTS, return_exceptions=True)
    assert {*map(type, results.values())} == {GatewayTargetFailedToRespond}
    assert len(peer.requests) == 1


def test_a_device_that_is_silent_about_its_first_registers_is_asked_for_the_others(world: World):
    with world.client_of("tcp", silent_about(0), timeout=0.5) as plc:
        assert not values(plc.read_map(POINTS, return_exceptions=True))
        for _ in range(3):
            with world.lasting(0.5):
                results = plc.read_map(POINTS, return_exceptions=True)
            assert values(results) == {"p1", "p2", "p3", "p4", "p5"}


def test_a_device_that_answered_before_is_asked_for_all(world: World) -> None:
    with world.client_of("tcp", silent_about(20, 40), timeout=0.5) as plc, world.lasting(1.0):
        results = plc.read_many(ITEMS, return_exceptions=True)
    assert values(results) == {"p0", "p1", "p3", "p5"}


def test_requests_of_the_caller_are_all_sent(world: World) -> None:
    requests = [pdu.ReadHoldingRegisters(at, 1) for at in range(3)]
    with world.client_of("tcp", ignore, timeout=0.5) as plc, world.lasting(1.5):
        outcomes = plc.execute_many(requests, return_exceptions=True)
    assert {*map(type, outcomes)} == {ModbusTimeoutError}


def test_a_lost_connection_ends_only_its_request(world: World) -> None:
    closes = iter([True])

    def on_request(request: bytes, write: Write) -> None:
        write(None if next(closes, False) else answer(request, "tcp"))

    with world.client_of("tcp", on_request) as plc:
        results = plc.read_map(POINTS, return_exceptions=True)
    assert isinstance(results["p0"], ModbusConnectionError)
    assert values(results) == {"p1", "p2", "p3", "p4", "p5"}


def test_without_return_exceptions_the_first_error_is_raised(world: World) -> None:
    for read in (lambda plc: plc.read_many(ITEMS), lambda plc: plc.read_map(POINTS)):
        with (
            world.client_of("tcp", ignore, timeout=0.5) as plc,
            world.lasting(0.5),
            pytest.raises(ModbusTimeoutError, match="address=0"),
        ):
            read(plc)


REFUSED = ModbusConnectionError("refused", errno=111)


def made(max_pause: float = 30.0, **options: Any) -> Reconnecting:
    notices = options.get("notices", Notices())
    place = "192.0.2.1:502"
    return Reconnecting(place, max_pause, Statistics(), notices, options.get("on_state"))


def fail(connection: Reconnecting, now: float) -> float:
    """Note a failed attempt; return the pause after it."""
    connection.connecting()
    connection.failed(REFUSED, now)
    return connection.next_attempt - now


def test_requests_without_time_for_the_next_attempt_raise_the_reason_of_the_last() -> None:
    connection = made()
    assert connection.refusal(0, 1) is None
    for _ in range(5):
        fail(connection, 100)
    assert connection.refusal(100, 103) is None
    refusal = connection.refusal(100, 101)
    assert refusal is not None
    assert refusal.errno == 111
    assert str(refusal).startswith("refused; next attempt in 1.")
    connection.connecting()
    assert connection.refusal(100, 101) is None  # it may come in time


def test_states_are_reported_with_their_reasons_and_closed_is_the_last() -> None:
    states: list[tuple[State, Any]] = []
    notices = Notices()
    connection = made(on_state=lambda state, error: states.append((state, error)), notices=notices)
    connection.connecting()
    connection.opened()
    assert connection.is_open
    connection.lost(REFUSED, 0, by_itself=True)
    assert not connection.is_open
    fail(connection, 0)
    connection.close()
    connection.close()
    connection.opened()
    assert states == []
    notices.give()
    assert states == [
        (State.CONNECTING, None),
        (State.CONNECTED, None),
        (State.DISCONNECTED, REFUSED),
        (State.CONNECTING, None),
        (State.DISCONNECTED, REFUSED),
        (State.CLOSED, None),
    ]
    refusal = connection.refusal(0, 1e9)
    assert refusal is not None
    assert "closed" in str(refusal)
