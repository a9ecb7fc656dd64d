"""
How many requests may be in flight: it is found out, and reads lost beside others are asked alone.
"""

from __future__ import annotations

import logging
from collections import deque
from typing import Any

import pytest

from libmodbus_py import ModbusTimeoutError, pdu
from libmodbus_py.ports.schemes import SCHEMES
from tests.support.clients import World
from tests.support.peers import Write, echo, has_header, ignore, mbap
from tests.support.reads import echoes, reads

# Requests may be in flight beside others where frames have transaction ids.
each_scheme = pytest.mark.parametrize("scheme", [*filter(has_header, SCHEMES)])

BUSY = b"\x83\x06"


class Device:
    """
    Answers one request after the other.

    Args:
        places: for requests, the one that is being answered included.
        refusal: the PDU that answers those without a place; None to lose them.
        takes: how many seconds an answer takes.
    """

    def __init__(
        self, world: Any, places: int, refusal: bytes | None = None, takes: float = 0.005
    ) -> None:
        self._events = world.network.events
        self._takes = takes
        self._places = places
        self._refusal = refusal
        self._waiting: deque[tuple[bytes, Write]] = deque()
        self.most = 0

    def __call__(self, request: bytes, write: Write) -> None:
        if len(self._waiting) >= self._places:
            if self._refusal is not None:
                write(mbap(request, self._refusal))
            return
        self._waiting.append((request, write))
        self.most = max(self.most, len(self._waiting))
        if len(self._waiting) == 1:
            self._events.after(self._takes, self._answer)

    def _answer(self) -> None:
        request, write = self._waiting.popleft()
        write(echo(request))
        if self._waiting:
            self._events.after(self._takes, self._answer)


@each_scheme
def test_a_device_that_takes_many_gets_many(world: World, scheme: str) -> None:
    device = Device(world, 16)
    with world.client_of(scheme, device) as context:
        assert context.max_in_flight == 1
        assert context.execute_many(reads(100)) == echoes(100)
        assert device.most == 16
        assert context.max_in_flight >= 16
        assert context.statistics.falls == context.statistics.retries == 0


@each_scheme
@pytest.mark.parametrize("places", [1, 2, 4, 8])
def test_a_device_that_loses_requests_loses_no_value(
    world: World, scheme: str, places: int
) -> None:
    """It costs a quarter of the timeout once; from then on one is in flight, and none is lost."""
    with world.client_of(scheme, Device(world, places), timeout=4) as context:
        with world.lasting(200 * 0.005, more=1.2):
            assert context.execute_many(reads(200)) == echoes(200)
        assert context.max_in_flight == 1
        assert context.statistics.falls == 1
        assert context.statistics.timeouts == 0
        again = context.statistics.retries
        assert 1 <= again < 16
        with world.lasting(200 * 0.005, more=0.2):
            assert context.execute_many(reads(200)) == echoes(200)
        assert context.statistics.retries == again


@each_scheme
def test_a_busy_device_gets_one_at_a_time(world: World, scheme: str) -> None:
    with world.client_of(scheme, Device(world, 2, BUSY), timeout=60) as context:
        with world.lasting(50 * 0.005, more=0.2):  # a refusal is known at once
            assert context.execute_many(reads(50)) == echoes(50)
        assert context.max_in_flight == context.statistics.falls == 1


@each_scheme
def test_one_that_was_set_is_obeyed_at_once(world: World, scheme: str) -> None:
    device = Device(world, 4)
    with world.client_of(scheme, device, max_in_flight=8, timeout=0.3) as context:
        found = context.execute_many(reads(8), return_exceptions=True)
        assert found[:4] == echoes(4)
        assert [type(each) for each in found[4:]] == [ModbusTimeoutError] * 4
        assert context.statistics.retries == 0
        assert context.max_in_flight == 8
        assert device.most == 4


@each_scheme
def test_all_clients_of_the_process_know_and_it_is_told_once(
    world: World, scheme: str, caplog: pytest.LogCaptureFixture
) -> None:
    device = Device(world, 1)
    peer = world.peer(scheme, device)
    with caplog.at_level(logging.WARNING), world.connect(peer.url) as before:
        before.execute(pdu.ReadHoldingRegisters(0, 1))
        with world.connect(peer.url) as context:
            assert context.execute_many(reads(20)) == echoes(20)
            assert context.statistics.falls == 1
        for other in (before, world.connect(peer.url)):
            with other:
                assert other.execute_many(reads(20)) == echoes(20)
                assert other.max_in_flight == 1
                assert other.statistics.falls == other.statistics.retries == 0
        with world.connect(peer.url, max_in_flight=4) as other:
            assert other.max_in_flight == 4
    (record,) = caplog.records
    assert "one is sent at a time (max_in_flight=1" in record.getMessage()


@each_scheme
def test_what_is_known_holds_for_the_next_connection(world: World, scheme: str) -> None:
    device = Device(world, 1)
    peer = world.peer(scheme, device)
    with world.connect(peer.url) as context:
        assert context.execute_many(reads(20)) == echoes(20)
        again = context.statistics.retries
        peer.drop_all()  # type: ignore[attr-defined]
        device._places = 16
        assert context.execute_many(reads(100)) == echoes(100)
        assert device.most == 1
        assert context.statistics.retries == again


@each_scheme
def test_a_device_that_stood_still_is_not_limited_to_one(world: World, scheme: str) -> None:
    """The requests are answered, though they were given up: they were not lost, only late."""
    device = Device(world, 16)
    peer = world.peer(scheme, device)
    with world.connect(peer.url, timeout=2) as context:
        context.execute_many(reads(100))
        held: list[tuple[bytes, Write]] = []
        peer.on_request = lambda request, write: held.append((request, write))

        def go_on() -> None:
            peer.on_request = device
            for request, write in held:
                write(echo(request))

        world.network.events.after(2.3, go_on)  # type: ignore[attr-defined]
        assert context.execute_many(reads(16)) == echoes(16)
        assert context.max_in_flight >= 8
        assert context.statistics.falls == 0


def test_a_device_that_answers_too_many_too_late_gets_half_as_many(world: World) -> None:
    """As a gateway does to a slow line: 16 answers of 0.1 s each take longer than the timeout."""
    with world.client_of("tcp", Device(world, 100, takes=0.1), timeout=1) as context:
        assert context.execute_many(reads(60)) == echoes(60)
        again = context.statistics.retries
        assert 0 < again < 32
        assert context.execute_many(reads(60)) == echoes(60)
        assert context.max_in_flight > 1
        assert context.statistics.retries == again
        assert context.statistics.falls == 0


@each_scheme
def test_one_dead_request_holds_others_up_once(world: World, scheme: str) -> None:
    """It is asked again alone; the others go on when its second time is over."""

    def but_five(request: bytes, write: Write) -> None:
        if request[9] != 5:
            write(echo(request))

    with world.client_of(scheme, but_five, timeout=1) as context, world.lasting(1.25, more=0.1):
        found = context.execute_many(reads(100), return_exceptions=True)
        assert isinstance(found[5], ModbusTimeoutError)
        assert found[:5] + found[6:] == echoes(5) + echoes(100)[6:]
        assert context.statistics.falls == 0


@each_scheme
def test_nothing_is_concluded_of_a_device_that_never_answers(world: World, scheme: str) -> None:
    with world.client_of(scheme, ignore, timeout=1) as context:
        found = context.execute_many(reads(16), return_exceptions=True)
        assert {type(each) for each in found} == {ModbusTimeoutError}
        assert context.statistics.falls == context.statistics.retries == 0
