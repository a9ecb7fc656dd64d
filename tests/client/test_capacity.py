"""
How many requests a device takes at once is found out: it begins with one, doubles, and falls
where requests beside others are lost.
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
from tests.support.talk import Talk, tcp

# Requests may be in flight beside others where frames have transaction ids.
each_scheme = pytest.mark.parametrize("scheme", [*filter(has_header, SCHEMES)])

BUSY = b"\x83\x06"


class Device:
    """
    Answers one request after the other, 5 ms each.

    Args:
        places: for requests, the one that is being answered included.
        refusal: the PDU that answers those without a place; None to lose them.
    """

    def __init__(self, world: Any, places: int, refusal: bytes | None = None) -> None:
        self._events = world.network.events
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
            self._events.after(0.005, self._answer)

    def _answer(self) -> None:
        request, write = self._waiting.popleft()
        write(echo(request))
        if self._waiting:
            self._events.after(0.005, self._answer)


def reads(count: int) -> list[pdu.Request[Any]]:
    return [pdu.ReadHoldingRegisters(address, 1) for address in range(count)]


def echoes(count: int) -> list[list[int]]:
    return [[address] for address in range(count)]


class Clumsy:
    """Loses both of two requests of which one comes while the other waits for its answer."""

    def __init__(self, world: Any) -> None:
        self._events = world.network.events
        self._waiting: list[tuple[bytes, Write]] = []

    def __call__(self, request: bytes, write: Write) -> None:
        self._waiting.append((request, write))
        if len(self._waiting) == 1:
            self._events.after(0.005, self._answer)

    def _answer(self) -> None:
        waiting, self._waiting = self._waiting, []
        if len(waiting) == 1:
            ((request, write),) = waiting
            write(echo(request))


def test_requests_that_are_all_lost_leave_their_places_to_the_others(world: World) -> None:
    """At most two of these are in flight, also when both are to be asked again alone."""
    peer = world.peer("tcp", Clumsy(world))
    with world.connect(peer.url) as context:
        assert context.execute_many(reads(20), max_in_flight=2) == echoes(20)
        assert context.statistics.falls == 1
        assert context.statistics.timeouts >= 2


@each_scheme
@pytest.mark.parametrize("places", [1, 2, 4, 8])
def test_a_device_that_loses_requests_loses_no_value(
    world: World, scheme: str, places: int
) -> None:
    device = Device(world, places)
    peer = world.peer(scheme, device)
    with world.connect(peer.url) as context:
        assert context.execute_many(reads(200)) == echoes(200)
        assert context.max_in_flight == places
        assert context.statistics.falls == 1
        lost = context.statistics.timeouts
        assert context.execute_many(reads(200)) == echoes(200)
        assert context.statistics.timeouts == lost


@each_scheme
def test_a_device_that_takes_many_gets_many(world: World, scheme: str) -> None:
    device = Device(world, 16)
    peer = world.peer(scheme, device)
    with world.connect(peer.url) as context:
        assert context.max_in_flight == 1
        assert context.execute_many(reads(100)) == echoes(100)
        assert device.most == 16
        assert context.max_in_flight >= 16
        assert context.statistics.falls == context.statistics.retries == 0


@each_scheme
def test_busy_is_a_sign_too(world: World, scheme: str) -> None:
    peer = world.peer(scheme, Device(world, 2, BUSY))
    with world.connect(peer.url) as context:
        assert context.execute_many(reads(50)) == echoes(50)
        assert context.max_in_flight == 2


@each_scheme
def test_one_that_was_set_is_fixed(world: World, scheme: str) -> None:
    peer = world.peer(scheme, Device(world, 4))
    with world.connect(peer.url, max_in_flight=8, timeout=0.3) as context:
        found = context.execute_many(reads(8), return_exceptions=True)
        assert found[:4] == echoes(4)
        assert [type(each) for each in found[4:]] == [ModbusTimeoutError] * 4
        assert context.statistics.retries == 0


@each_scheme
def test_it_is_told_once(world: World, scheme: str, caplog: pytest.LogCaptureFixture) -> None:
    device = Device(world, 8)
    peer = world.peer(scheme, device)
    with world.connect(peer.url) as context, caplog.at_level(logging.WARNING):
        context.execute_many(reads(100))
        device._places = 1
        assert context.execute_many(reads(100)) == echoes(100)
        assert context.max_in_flight == 1
        assert context.statistics.falls > 1
    (record,) = caplog.records
    assert "8 in flight from now on" in record.getMessage()


@each_scheme
def test_a_new_connection_begins_anew(world: World, scheme: str) -> None:
    device = Device(world, 1)
    peer = world.peer(scheme, device)
    with world.connect(peer.url) as context:
        context.execute_many(reads(20))
        assert context.max_in_flight == 1
        peer.drop_all()  # type: ignore[attr-defined]
        device._places = 16
        assert context.execute_many(reads(100)) == echoes(100)
        assert device.most > 4


@each_scheme
def test_a_device_that_stood_still_keeps_what_it_had(world: World, scheme: str) -> None:
    """Its late answers show that it lost nothing."""
    device = Device(world, 16)
    peer = world.peer(scheme, device)
    with world.connect(peer.url, timeout=0.5) as context:
        context.execute_many(reads(100))
        held: list[tuple[bytes, Write]] = []
        peer.on_request = lambda request, write: held.append((request, write))

        def go_on() -> None:
            peer.on_request = device
            for request, write in held:
                write(echo(request))

        world.network.events.after(0.55, go_on)  # type: ignore[attr-defined]
        assert context.execute_many(reads(16)) == echoes(16)
        assert context.max_in_flight >= 8


@each_scheme
def test_one_dead_request_holds_others_up_once(world: World, scheme: str) -> None:
    """A trial without an answer says that the number in flight was not the reason."""

    def but_five(request: bytes, write: Write) -> None:
        if request[9] != 5:
            write(echo(request))

    peer = world.peer(scheme, but_five)
    with world.connect(peer.url, timeout=1) as context, world.lasting(1.25, more=0.1):
        found = context.execute_many(reads(100), return_exceptions=True)
        assert isinstance(found[5], ModbusTimeoutError)
        assert found[:5] + found[6:] == echoes(5) + echoes(100)[6:]
        assert context.statistics.falls == 0


@each_scheme
def test_nobody_waits_for_each_of_many_when_nothing_answers(world: World, scheme: str) -> None:
    peer = world.peer(scheme, ignore)
    with world.connect(peer.url, timeout=1) as context:
        before = world.now
        found = context.execute_many(reads(16), return_exceptions=True)
        assert {type(each) for each in found} == {ModbusTimeoutError}
        assert world.now - before <= 8


# --- the conversation ------------------------------------------------------------------------


def grown() -> Talk:
    """Return a talk that may have several requests in flight."""
    talk = Talk(max_in_flight=None, timeout=1)
    talk.ask(*range(7), limit=16)
    while len(talk.sent) < 7 or not talk.is_at_rest:
        pending = talk.conversation.in_flight
        talk.come(*[tcp(each) for each in talk.sent[len(talk.sent) - pending :]])
    assert talk.conversation.limit >= 4
    return talk


def test_requests_that_may_not_be_sent_twice_are_not() -> None:
    talk = grown()
    sent = len(talk.sent)
    one, other = talk.ask(pdu.Diagnostics(pdu.SubFunction(0), b"ab")), talk.ask(1)
    talk.come(tcp(talk.sent[-1]))
    talk.wait(2)
    assert other.outcomes == [[1]]
    assert isinstance(one.outcomes[0], ModbusTimeoutError)
    assert len(talk.sent) == sent + 2


def test_a_write_is_not_sent_again_over_a_newer_one() -> None:
    talk = grown()
    older, newer = talk.ask(pdu.WriteRegister(1, 1)), talk.ask(pdu.WriteRegister(1, 2))
    talk.come(tcp(talk.sent[-1], "06 00 01 00 02"))
    sent = len(talk.sent)
    talk.wait(2)
    assert newer.outcomes == [None]
    assert isinstance(older.outcomes[0], ModbusTimeoutError)
    assert len(talk.sent) == sent


def test_one_that_was_alone_is_not_sent_again() -> None:
    talk = grown()
    batch, sent = talk.ask(1), len(talk.sent)
    talk.wait(2)
    assert isinstance(batch.outcomes[0], ModbusTimeoutError)
    assert len(talk.sent) == sent


@pytest.mark.parametrize("when", ["before the trial", "in the trial"])
def test_a_caller_who_leaves_holds_nobody_up(when: str) -> None:
    talk = grown()
    one, other = talk.ask(1), talk.ask(2)
    if when == "before the trial":
        talk.wait(0.5)
        third = talk.ask(3)  # in flight while the two are over
        talk.wait(0.5)
        talk.cancel(one)
        talk.come(tcp(talk.sent[-1]))
        assert third.outcomes == [[3]]
    else:
        talk.wait(1)
        talk.cancel(one)
    talk.come(tcp(talk.sent[-1]))
    assert other.outcomes == [[2]]
    assert talk.is_at_rest


@pytest.mark.parametrize("end", ["lost", "closed", "refused"])
def test_what_was_lost_ends_with_the_connection(end: str) -> None:
    talk = grown()
    batches = [talk.ask(1), talk.ask(2), talk.ask(3)]
    talk.wait(1)  # one of them is asked alone
    if end == "lost":
        talk.lose()
    elif end == "closed":
        talk.conversation.closed(ModbusTimeoutError("closed"), talk.now)  # type: ignore[arg-type]
    else:
        talk.conversation.refuse(ModbusTimeoutError("forbidden"))
        talk.wait(1)
    assert all(batch.is_done for batch in batches)
    assert talk.is_at_rest
