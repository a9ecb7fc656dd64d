"""Calls that end early, by an exception at any moment: nothing of them is sent later."""

from __future__ import annotations

import asyncio
import contextlib
import sys
from collections.abc import Callable
from functools import partial
from types import FrameType
from typing import Any

import pytest

from libmodbus_py import AsyncClient, Client, pdu
from libmodbus_py.client.sender import Sender
from tests.simulation.loop import complaints_of
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.clients import making
from tests.support.peers import Peer, Write, answer, peer_at
from tests.support.urls import url_for

PLACES_OF_SIGNALS = ("call", "c_call", "c_return")

# The seconds that frames need to arrive.
SETTLED = 0.1

ERRORS = [TimeoutError("its own"), MemoryError(), KeyboardInterrupt()]

TRANSPORTS = pytest.mark.parametrize("scheme", ["tcp", "rtu", "udp"])
RAISED = pytest.mark.parametrize("error", ERRORS, ids=lambda each: type(each).__name__)


class Strike:
    """
    Raises an exception at the n-th place where Python would run the handler of a signal.

    Those are the beginnings of functions, and the ends of calls of C; what C waits in may also be
    interrupted.
    """

    def __init__(self, number: int, error: BaseException) -> None:
        self.left = number
        self._error = error.with_traceback(None)

    def __enter__(self) -> Strike:
        sys.setprofile(self._note)
        return self

    def __exit__(self, *_: object) -> None:
        sys.setprofile(None)

    def _note(self, frame: FrameType, event: str, arg: object) -> None:
        if event in PLACES_OF_SIGNALS and "/libmodbus_py/" in frame.f_code.co_filename:
            self.left -= 1
            if self.left == 0:
                raise self._error


def address_in(request: bytes, scheme: str) -> int:
    """Return the address that a request names."""
    at = 2 if scheme == "rtu" else 8
    return int.from_bytes(request[at : at + 2], "big")


def replying(scheme: str) -> Callable[[bytes, Write], object]:
    """Return what answers reads with the address, and confirms writes."""
    function = 1 if scheme == "rtu" else 7

    def reply(request: bytes, write: Write) -> None:
        write(request if request[function] == 6 else answer(request, scheme))

    return reply


def struck(
    call: Callable[[], object], number: int, error: BaseException
) -> tuple[bool, BaseException | None]:
    """Return whether a call had so many moments, and the exception that it raised."""
    failure = None
    with Strike(number, error) as strike:
        try:
            call()
        except BaseException as caught:
            failure = caught
    return strike.left <= 0, failure


def strike_each_moment(
    context: Client,
    peer: Peer | Scripted,
    scheme: str,
    error: BaseException,
    settle: Callable[[], object] = lambda: None,
    step: int = 1,
) -> int:
    """
    Strike a write and a read at each of their moments; return how many there were. `settle`: let
    what was sent arrive; `step`: from one moment to the next that is tried.
    """
    number = address = 0
    was_struck = True
    while was_struck:
        number += step
        was_struck = False
        for ask in (context.write_register, context.read_holding_registers):
            address += 2
            is_struck, failure = struck(partial(ask, address, 1), number, error)
            assert failure is (error if is_struck else None), (number, ask, failure)
            was_struck |= is_struck
            settle()
            assert context.read_holding_registers(address + 1, 1) == [address + 1], (number, ask)
            addresses = [address_in(request, scheme) for request in peer.requests]
            assert addresses[-1] == address + 1, (number, ask)
            assert addresses.count(address) <= 1
    return number


@RAISED
@TRANSPORTS
def test_no_request_of_a_call_is_sent_after_an_exception_ended_the_call(
    scheme: str, error: BaseException
) -> None:
    with making("blocking") as world:
        peer = world.peer(scheme, replying(scheme))
        with world.connect(peer.url, retries=1) as context:
            settle = partial(world.sleep, SETTLED)
            assert strike_each_moment(context, peer, scheme, error, settle) > 50


@pytest.mark.parametrize(
    ("scheme", "error"),
    [
        *(("tcp", error) for error in ERRORS),
        *((scheme, KeyboardInterrupt()) for scheme in ("rtu", "udp")),
    ],
)
def test_nothing_is_sent_of_an_interrupted_call_on_a_real_port(scheme, error) -> None:
    with peer_at(scheme, replying(scheme)) as peer:
        # On a line a unit that owes an answer is left alone for one timeout, in real seconds.
        options, step = ({"timeout": 0.25}, 15) if scheme == "rtu" else ({}, 1)
        with Client(peer.url, retries=1, **options) as context:
            assert strike_each_moment(context, peer, scheme, error, step=step) * step > 100


def ended(loop: asyncio.AbstractEventLoop, tasks: list[asyncio.Task[Any]]) -> None:
    """Run a loop until tasks are done, whatever other exceptions are raised there."""
    while not all(task.done() for task in tasks):
        with contextlib.suppress(SystemExit):
            loop.run_until_complete(asyncio.wait(tasks))


class Leaving:
    """A hook that raises SystemExit the n-th time that it is called."""

    def __init__(self) -> None:
        self.left = -1

    def __call__(self, *_: object) -> bool:
        self.left -= 1
        if self.left == 0:
            raise SystemExit
        return True


@pytest.mark.parametrize("hook", ["trace", "on_state", "may_send", "on_done", "decode_response"])
@TRANSPORTS
def test_all_callers_return_when_a_callback_ends_the_program(scheme: str, hook: str) -> None:
    """Three callers at once; the program goes on after SystemExit, and every caller is told."""
    network = Network()
    peer = Scripted(network, url_for(scheme, line="/dev/line?baudrate=115200"), replying(scheme))
    loop = network.loop()
    leave = Leaving()
    options = {hook: leave} if hook in ("trace", "on_state", "may_send") else {}

    class Read(pdu.ReadHoldingRegisters):
        __slots__ = ()

        def decode_response(self, data: bytes) -> list[int]:
            if hook == "decode_response":
                leave()
            return super().decode_response(data)

    async def submit(plc: AsyncClient, address: int) -> object:
        future = loop.create_future()

        def on_done() -> None:
            future.set_result(None)
            if hook == "on_done":
                leave()

        submitted = Sender(plc).submit(1, pdu.ReadHoldingRegisters(address, 1), on_done)
        await future
        return submitted.outcome

    number, is_left = 0, True
    with network.installed(), complaints_of(loop):
        while is_left:
            number += 1
            leave.left = number
            plc = AsyncClient(peer.url, retries=1, **options)
            asks = plc.write_register(20, 1), plc.execute(Read(30, 1)), submit(plc, 40)
            tasks = [loop.create_task(ask) for ask in asks]
            ended(loop, tasks)
            is_left = leave.left <= 0
            leave.left = -1
            for task, result in zip(tasks, (None, [30], [40]), strict=True):
                if task.exception() is None and not isinstance(task.result(), Exception):
                    assert task.result() == result
            loop.run_until_complete(asyncio.sleep(SETTLED))
            assert loop.run_until_complete(plc.read_holding_registers(51, 1)) == [51]
            assert not plc._driver._callers
            loop.run_until_complete(plc.close())
    loop.close()
    assert number > 1


def writes(first: int) -> list[pdu.WriteRegister]:
    """Return five writes to addresses from the first on."""
    return [pdu.WriteRegister(first + at, 1) for at in range(5)]


def test_none_of_many_requests_is_sent_after_an_exception_ended_their_call() -> None:
    error, number, is_struck = MemoryError(), 0, True
    with making("blocking") as world:
        peer = world.peer("tcp", replying("tcp"))
        with world.connect(peer.url) as context:
            while is_struck:
                number += 1
                call = partial(context.execute_many, writes(10 * number))
                is_struck, failure = struck(call, number, error)
                assert failure is (error if is_struck else None), (number, failure)
                world.sleep(SETTLED)
                before = len(peer.requests)
                assert context.read_holding_registers(10 * number + 9, 1) == [10 * number + 9]
                assert len(peer.requests) == before + 1, number
    assert number > 200
