"""
The short way of a request that is alone changes nothing but the time that it costs.

Each exchange takes place twice: on the short way, and, because the client is traced, through the
conversation. Results, counters and times must be the same.
"""

from __future__ import annotations

import asyncio
import contextlib
import copy
import random
from collections.abc import Awaitable, Callable
from dataclasses import fields
from typing import Any

import pytest

from libmodbus_py import AsyncClient, framing, pdu
from libmodbus_py.client import conversation
from libmodbus_py.client.lone_request import LoneRequest
from tests.simulation.events import Events
from tests.simulation.loop import complaints_of
from tests.simulation.network import Network
from tests.simulation.scripted import Scripted
from tests.support.peers import UNKNOWN_FUNCTION, OnRequest, Write, answer, mbap

SCHEMES = ["tcp", "udp", "rtu+tcp", "rtu+udp"]

# Before the strange answers: the number in flight is found out with the first ones.
BEFORE = 8

STRANGE = range(BEFORE, BEFORE + 3)
AFTER = range(BEFORE + 3, BEFORE + 12)

# An answer to a request that was asked so long ago comes in time for the next one.
LATE = 0.35


def form(scheme: str) -> str:
    return "rtu" if scheme.startswith("rtu") else scheme


def good(request: bytes, scheme: str) -> bytes:
    """Answer a read with the address, and a write with itself."""
    function = request[1 if form(scheme) == "rtu" else 7]
    if function == UNKNOWN_FUNCTION and form(scheme) == "rtu":
        return request + framing.crc16(request).to_bytes(2, "little")
    return answer(request, form(scheme)) if function == 3 else request


def exception(request: bytes, scheme: str) -> bytes:
    if form(scheme) != "rtu":
        return mbap(request, b"\x83\x02")
    body = request[:1] + b"\x83\x02"
    return body + framing.crc16(body).to_bytes(2, "little")


def halves(request: bytes, write: Write, scheme: str) -> None:
    whole = good(request, scheme)
    write(whole[:5])
    write(whole[5:], after=0.01)


def twice(request: bytes, write: Write, scheme: str) -> None:
    write(good(request, scheme))
    write(good(request, scheme), after=0.003)


def together(request: bytes, write: Write, scheme: str) -> None:
    write(good(request, scheme))
    write(good(request, scheme))


def long_answer(request: bytes, write: Write, scheme: str) -> None:
    """Write a frame that claims more than a frame may contain, with the right id."""
    write(mbap(request, b"\x03\xff" + bytes(255) + bytes(10)))


ODD: dict[str, Callable[[bytes, Write, str], object]] = {
    "good": lambda request, write, scheme: write(good(request, scheme)),
    "nothing": lambda request, write, scheme: None,
    "in two parts": halves,
    "twice": twice,
    "twice at once": together,
    "late": lambda request, write, scheme: write(good(request, scheme), after=LATE),
    "refused": lambda request, write, scheme: write(exception(request, scheme)),
    "another unit": lambda request, write, scheme: write(answer(request, form(scheme), unit=9)),
    "two registers": lambda request, write, scheme: write(
        mbap(request, b"\x03\x04\x00\x01\x00\x02")
        if form(scheme) != "rtu"
        else bytes.fromhex("01 03 04 0001 0002 2A32")
    ),
    "another function": lambda request, write, scheme: write(
        mbap(request, b"\x04\x02\x00\x01") if form(scheme) != "rtu" else b"\x01\x04\x02\0\1\x78\xf0"
    ),
    "noise": lambda request, write, scheme: write(b"\xfe\x00\x41"),
    "the request": lambda request, write, scheme: write(request),
    "closed": lambda request, write, scheme: write(None),
    "too long": long_answer,
}


def odd_at(odd: Callable[[bytes, Write, str], object], scheme: str) -> OnRequest:
    """Answer the addresses `STRANGE` in an odd way, and all others as they should be."""

    def on_request(request: bytes, write: Write) -> None:
        at = 8 if scheme in ("tcp", "udp") else 2
        if form(scheme) == "rtu" and request[0] == 0:
            return  # a broadcast
        is_odd = int.from_bytes(request[at : at + 2], "big") in STRANGE
        way = odd if is_odd else ODD["good"]
        way(request, write, scheme)

    return on_request


Steps = Callable[[AsyncClient], Awaitable[list[Any]]]


async def outcome(awaitable: Awaitable[Any]) -> Any:
    """Return a value, or the type and the text of the exception."""
    try:
        return await awaitable
    except (Exception, asyncio.CancelledError) as error:
        return type(error), str(error)


async def one_after_the_other(plc: AsyncClient) -> list[Any]:
    got = [await outcome(plc.read_holding_registers(at, 1)) for at in range(AFTER.stop)]
    return [*got, plc.max_in_flight]


async def interrupted(plc: AsyncClient, act: Callable[[asyncio.Task[Any]], object]) -> list[Any]:
    """Do something while each of the odd requests is in flight."""
    got = [await outcome(plc.read_holding_registers(at, 1)) for at in range(BEFORE)]
    for at in STRANGE:
        task = asyncio.create_task(outcome(plc.read_holding_registers(at, 1)))
        await asyncio.sleep(0.0001)
        got.append(await outcome(_made(act(task))))
        got.append(await outcome(task))
    return got + [await outcome(plc.read_holding_registers(at, 1)) for at in AFTER]


async def _made(value: Any) -> Any:
    return await value if asyncio.iscoroutine(value) else value


async def cancelled(plc: AsyncClient) -> list[Any]:
    return await interrupted(plc, lambda task: task.cancel())


async def beside_another(plc: AsyncClient) -> list[Any]:
    return await interrupted(plc, lambda task: plc.read_holding_registers(99, 1))


async def with_less_time(plc: AsyncClient) -> list[Any]:
    def shorten(task: asyncio.Task[Any]) -> None:
        plc.timeout = 0.05

    return await interrupted(plc, shorten)


async def closed(plc: AsyncClient) -> list[Any]:
    return await interrupted(plc, lambda task: plc.close())


async def many_at_once(plc: AsyncClient) -> list[Any]:
    got = await one_after_the_other(plc)
    for _ in range(3):
        got += await asyncio.gather(*(outcome(plc.read_holding_registers(at, 1)) for at in AFTER))
        got.append(plc.max_in_flight)
    return got


async def with_pauses(plc: AsyncClient) -> list[Any]:
    """Late bytes are read while no request is in flight."""
    got = []
    for at in range(AFTER.stop):
        got.append(await outcome(plc.read_holding_registers(at, 1)))
        await asyncio.sleep(LATE)
    return got


class StandingStill:
    """The event loop stands still before each request, while bytes come that nobody reads."""

    __name__ = "after_a_standstill"

    def __init__(self) -> None:
        self.events = Events(0)

    async def __call__(self, plc: AsyncClient) -> list[Any]:
        got = []
        for at in range(AFTER.stop):
            until = self.events.now + LATE
            while self.events.now < until:
                self.events.advance(until)
            got.append(await outcome(plc.read_holding_registers(at, 1)))
        return got


after_a_standstill = StandingStill()


async def to_all_units(plc: AsyncClient) -> list[Any]:
    got = []
    for at in range(AFTER.stop):
        got.append(await outcome(plc.read_holding_registers(at, 1)))
        got.append(await outcome(plc.for_unit(0).write_register(at, at)))
    return got


async def of_an_unknown_length(plc: AsyncClient) -> list[Any]:
    """The first part of each answer is a frame by itself, and silence ends the whole one."""
    return [
        await outcome(plc.execute(pdu.RawRequest(UNKNOWN_FUNCTION, bytes([0, at, 0, 1]))))
        for at in range(AFTER.stop)
    ]


async def written(plc: AsyncClient) -> list[Any]:
    return [await outcome(plc.write_register(at, at)) for at in range(AFTER.stop)]


class Mistaken(pdu.ReadHoldingRegisters):
    """A request whose class cannot decode the odd answers."""

    def decode_response(self, data: bytes) -> Any:
        value = super().decode_response(data)
        if self.address in STRANGE:
            raise ZeroDivisionError("in the class of the request")
        return value


async def mistaken(plc: AsyncClient) -> list[Any]:
    return [await outcome(plc.execute(Mistaken(at, 1))) for at in range(AFTER.stop)]


WHAT = ("results", "counters", "requests", "time")

FEW = ["good", "nothing", "twice", "late", "closed"]

# Steps -> the odd answers that matter to them.
STEPS: dict[Steps, list[str]] = {
    one_after_the_other: list(ODD),
    with_pauses: ["twice", "late", "noise"],
    cancelled: FEW,
    beside_another: list(ODD),
    with_less_time: FEW,
    closed: FEW,
    many_at_once: FEW,
    after_a_standstill: FEW,
    to_all_units: FEW,
    of_an_unknown_length: ["good", "nothing"],
    written: FEW,
    mistaken: ["good", "refused"],
}


def played(scheme: str, odd: str, steps: Steps, is_traced: bool) -> Any:
    """Return all results of an exchange, what was counted, the requests, and when it was over."""
    random.seed(1)  # of the pauses before attempts to connect again
    network = Network()
    after_a_standstill.events = network.events
    loop = network.loop()
    options: dict[str, Any] = {"trace": lambda traced: None} if is_traced else {}

    async def play() -> tuple[list[Any], dict[str, Any]]:
        plc = AsyncClient(unit_of.url, timeout=0.3, retries=1, **options)
        async with contextlib.aclosing(_Closing(plc)):
            await plc.connect()
            results = await steps(plc)
        return results, {
            each.name: copy.copy(getattr(plc.statistics, each.name))
            for each in fields(plc.statistics)
        }

    with contextlib.closing(loop), network.installed(), complaints_of(loop) as complaints:
        unit_of = Scripted(network, f"{scheme}://10.0.0.1", odd_at(ODD[odd], scheme))
        results, counted = loop.run_until_complete(play())
        now = network.events.now
    assert not complaints
    return results, counted, unit_of.requests, now


class _Closing:
    def __init__(self, plc: AsyncClient) -> None:
        self.aclose = plc.close


@pytest.mark.parametrize("steps", STEPS, ids=lambda steps: steps.__name__)
@pytest.mark.parametrize("scheme", SCHEMES)
def test_it_changes_nothing(scheme: str, steps: Steps, monkeypatch: pytest.MonkeyPatch) -> None:
    alone: list[int] = []
    send = LoneRequest.send

    def counted(self: LoneRequest, batch: Any, now: float) -> float:
        alone.append(batch.unit)
        return send(self, batch, now)

    monkeypatch.setattr(LoneRequest, "send", counted)
    # Two copies of answers in a row are not a flood, because a request is sent between them.
    monkeypatch.setattr(conversation, "MAX_UNASKED", 20)
    is_short = steps is not of_an_unknown_length or form(scheme) != "rtu"
    for odd in STEPS[steps]:
        alone.clear()
        short = played(scheme, odd, steps, is_traced=False)
        assert bool(alone) == is_short, f"{odd}: which way was it?"
        alone.clear()
        long = played(scheme, odd, steps, is_traced=True)
        assert not alone
        for what, one, other in zip(WHAT, short, long, strict=True):
            assert one == other, f"{odd}: other {what}"


@pytest.mark.parametrize("scheme", SCHEMES)
def test_timers_of_earlier_requests_do_not_end_it(
    scheme: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each answer takes 0.2 s of its timeout of 0.3 s, in which the timer of the last one rings."""
    handed_over: list[int] = []
    hand_over = LoneRequest.hand_over

    def noted(self: LoneRequest) -> None:
        if self.batch is not None:
            handed_over.append(self.batch.unit)
        hand_over(self)

    monkeypatch.setattr(LoneRequest, "hand_over", noted)
    network = Network()
    loop = network.loop()

    async def play() -> list[list[int]]:
        async with AsyncClient(unit_of.url, timeout=0.3, max_in_flight=1) as plc:
            return [await plc.read_holding_registers(at, 1) for at in range(20)]

    def slowly(request: bytes, write: Write) -> None:
        write(good(request, scheme), after=0.2)

    with contextlib.closing(loop), network.installed(), complaints_of(loop) as complaints:
        unit_of = Scripted(network, f"{scheme}://10.0.0.1", slowly)
        assert loop.run_until_complete(play()) == [[at] for at in range(20)]
    assert not complaints
    assert not handed_over
