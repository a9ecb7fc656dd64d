"""
Which answer belongs to which request of a server's trace: the page and the pytest plugin agree.

Frames are those of the specification (messaging on TCP/IP, 3.1.3; application protocol, 6.3 and
6.5; serial line, 2.5.1.2), or carry check bytes that talk.py computes.
"""

from __future__ import annotations

import math
import tracemalloc
from typing import NamedTuple

from libmodbus_py.listen import Separator
from libmodbus_py.ports.trace import Traced
from libmodbus_py.tools.listener.pairing import MOST, MOST_CONNECTIONS, TIMEOUT, TracePairing
from libmodbus_py.tools.page.log import Log
from libmodbus_py.tools.page.units import ShownServer
from libmodbus_py.tools.testing.recording import transactions_of
from tests.support.cases import each_case
from tests.support.talk import rtu

TCP, LINE = "tcp://127.0.0.1:502", "rtu:///dev/ttyUSB0"

READ_PDU, VALUES_PDU = "03 006B 0003", "03 06 022B 0000 0064"
COIL_PDU = "05 00AC FF00"


def tcp(pdu: str, transaction: int = 1, unit: int = 17) -> bytes:
    data = bytes.fromhex(pdu)
    header = transaction.to_bytes(2, "big") + b"\0\0" + (len(data) + 1).to_bytes(2, "big")
    return header + bytes([unit]) + data


def line(pdu: str, unit: int = 17) -> bytes:
    return rtu(f"{unit:02x} {pdu}")


class Event(NamedTuple):
    """Bytes that a server received or sent, in seconds."""

    at: float
    direction: str
    adu: bytes
    peer: str = "one"
    is_frame: bool = True


def ask(at: float, adu: bytes, peer: str = "one") -> Event:
    return Event(at, "received", adu, peer)


def answer(at: float, adu: bytes, peer: str = "one") -> Event:
    return Event(at, "sent", adu, peer)


def damage(at: float, direction: str, data: bytes = b"\0\1\0") -> Event:
    return Event(at, direction, data, is_frame=False)


READ, READ_2 = tcp(READ_PDU), tcp(READ_PDU, 2)
VALUES, VALUES_2 = tcp(VALUES_PDU), tcp(VALUES_PDU, 2)

ON_TCP: dict[str, tuple[list[Event], list[str]]] = {
    "answered": ([ask(0, READ), answer(1, VALUES)], ["17:3 answered"]),
    "exception": ([ask(0, READ), answer(1, tcp("83 02"))], ["17:3 exception"]),
    "unanswered": ([ask(0, READ)], ["17:3 unanswered"]),
    "unanswered, and the next answered": (
        [ask(0, READ), ask(1, READ_2), answer(2, VALUES_2)],
        ["17:3 unanswered", "17:3 answered"],
    ),
    "several at once": (
        [ask(0, READ), ask(0.1, READ_2), answer(0.2, VALUES), answer(0.3, VALUES_2)],
        ["17:3 answered", "17:3 answered"],
    ),
    "several at once, the last answered first": (
        [ask(0, READ), ask(0.1, READ_2), answer(0.2, VALUES_2), answer(0.3, VALUES)],
        ["17:3 answered", "17:3 answered"],
    ),
    "slow": ([ask(0, READ), answer(4, VALUES)], ["17:3 answered"]),
    "the same id twice, together": (
        [ask(0, READ), ask(0, READ), answer(1, VALUES), answer(1, VALUES)],
        ["17:3 unanswered", "17:3 answered", "17:3 unasked"],
    ),
    "the same id again, later": (
        [ask(0, READ), ask(1, READ), answer(2, VALUES)],
        ["17:3 unanswered", "17:3 answered"],
    ),
    "the same id for another request": (
        [ask(0, READ), ask(1, tcp(COIL_PDU)), answer(2, tcp(COIL_PDU))],
        ["17:3 unanswered", "17:5 answered"],
    ),
    "answered twice": (
        [ask(0, READ), answer(1, VALUES), answer(2, VALUES)],
        ["17:3 answered", "17:3 unasked"],
    ),
    "answered twice, the second time within the next": (
        [ask(0, READ), answer(1, VALUES), ask(2, READ_2), answer(2, VALUES), answer(2, VALUES_2)],
        ["17:3 answered", "17:3 unasked", "17:3 answered"],
    ),
    "unasked": ([answer(0, VALUES)], ["17:3 unasked"]),
    "another transaction": ([ask(1, READ_2), answer(2, VALUES)], ["17:3 invalid"]),
    "another unit": ([ask(0, READ), answer(1, tcp(VALUES_PDU, unit=18))], ["17:3 invalid"]),
    "another function": ([ask(0, READ), answer(1, tcp("04 06 022B 0000 0064"))], ["17:3 invalid"]),
    "another count": ([ask(0, READ), answer(1, tcp("03 02 022B"))], ["17:3 invalid"]),
    "damaged answer": ([ask(0, READ), damage(1, "sent")], ["17:3 damaged"]),
    "damaged answer of the first of two": (
        [ask(0, READ), ask(0.0005, READ_2), damage(1, "sent"), answer(1, VALUES_2)],
        ["17:3 unanswered", "17:3 answered", "damaged"],
    ),
    "damaged answer to the second try": (
        [ask(0, READ), ask(1, READ_2), damage(1, "sent")],
        ["17:3 unanswered", "17:3 damaged"],
    ),
    "damaged request": ([damage(0, "received")], ["damaged"]),
    "no function": ([ask(0, tcp("83 006B 0003"))], ["17:None invalid"]),
    "unit 0": ([ask(0, tcp(COIL_PDU, unit=0)), answer(1, tcp(COIL_PDU, unit=0))], ["0:5 answered"]),
    "a question that wants silence": ([ask(0, tcp("08 0004 0000"))], ["17:8 broadcast"]),
    "several clients": (
        [
            ask(0, READ, "one"),
            ask(0.1, READ, "other"),
            answer(1, tcp("83 02"), "other"),
            answer(2, VALUES, "one"),
        ],
        ["17:3 answered", "17:3 exception"],
    ),
    "a connection that was closed": (
        [ask(0, READ, "one"), ask(1, READ, "other"), answer(2, VALUES, "other")],
        ["17:3 unanswered", "17:3 answered"],
    ),
}  # fmt: skip

ASK, ANSWER = line(READ_PDU), line(VALUES_PDU)
WRITE, WRITE_ALL = line(COIL_PDU), line(COIL_PDU, 0)
ASK_18, ANSWER_18 = line(READ_PDU, 18), line(VALUES_PDU, 18)

ON_LINES: dict[str, tuple[list[Event], list[str]]] = {
    "answered": ([ask(0, ASK), answer(1, ANSWER)], ["17:3 answered"]),
    "exception": ([ask(0, ASK), answer(1, line("83 02"))], ["17:3 exception"]),
    "answered by its echo": ([ask(0, WRITE), answer(1, WRITE)], ["17:5 answered"]),
    "broadcast": ([ask(0, WRITE_ALL)], ["0:5 broadcast"]),
    "unanswered": ([ask(0, ASK)], ["17:3 unanswered"]),
    "asked again": (
        [ask(0, ASK), ask(1, ASK), answer(2, ANSWER)],
        ["17:3 unanswered", "17:3 answered"],
    ),
    "asked again, and answered twice": (
        [ask(0, ASK), ask(1, ASK), answer(2, ANSWER), answer(3, ANSWER)],
        ["17:3 unanswered", "17:3 answered", "17:3 unasked"],
    ),
    "another one asked": (
        [ask(0, ASK), ask(1, ASK_18), answer(2, ANSWER_18)],
        ["17:3 unanswered", "18:3 answered"],
    ),
    "late, while another one is asked": (
        [ask(0, ASK), ask(1, ASK_18), answer(2, ANSWER), answer(3, ANSWER_18)],
        ["17:3 unanswered", "17:3 late", "18:3 answered"],
    ),
    "answered twice": (
        [ask(0, ASK), answer(1, ANSWER), answer(2, ANSWER)],
        ["17:3 answered", "17:3 unasked"],
    ),
    "damaged answer": ([ask(0, ASK), damage(1, "sent")], ["17:3 damaged"]),
    "noise before the answer": (
        [ask(0, ASK), damage(1, "sent"), answer(1, ANSWER)],
        ["17:3 answered", "damaged"],
    ),
    "noise behind the answer": (
        [ask(0, ASK), answer(1, ANSWER), damage(1, "sent")],
        ["17:3 answered", "damaged"],
    ),
    "another unit": ([ask(0, ASK), answer(1, ANSWER_18)], ["17:3 invalid"]),
}  # fmt: skip


def traced(event: Event, endpoint: str) -> Traced:
    at = 6 if endpoint == TCP else 0
    unit, function = event.adu[at : at + 2] if event.is_frame else (None, None)
    direction = event.direction
    return Traced(event.at, endpoint, direction, event.adu, unit, function, event.peer)  # type: ignore[arg-type]


def on_page(passed: list[Traced]) -> list[str]:
    log = Log(lambda: ShownServer({}, {}))
    for each in passed:
        log.note(each)
    rows = sorted(log.rows(), key=lambda row: row.time)
    return [told(row.unit, row.function, row.kind) for row in rows]


def in_plugin(passed: list[Traced]) -> list[str]:
    return [told(each.unit, each.function, each.kind) for each in transactions_of(passed)]


def by_listener(events: list[Event]) -> list[str]:
    separator, done = Separator("rtu"), []
    for at, direction, adu, _, _ in events:
        done += separator.feed(adu, at, "client" if direction == "received" else "server")
    done = sorted(done + separator.end(), key=lambda each: each.time)
    return [told(each.unit, each.function, each.kind) for each in done]


def told(unit: int | None, function: int | None, kind: str) -> str:
    return kind if unit is None else f"{unit}:{function} {kind}"


CASES = {
    f"{endpoint[:3]}, {name}": ([traced(each, endpoint) for each in events], kinds)
    for endpoint, table in ((TCP, ON_TCP), (LINE, ON_LINES))
    for name, (events, kinds) in table.items()
}


@each_case(("passed", "kinds"), CASES.values(), ids=CASES)
def test_the_page_shows(passed: list[Traced], kinds: list[str]) -> None:
    assert on_page(passed) == kinds


@each_case(("passed", "kinds"), CASES.values(), ids=CASES)
def test_the_plugin_records(passed: list[Traced], kinds: list[str]) -> None:
    assert in_plugin(passed) == kinds


# A listener may have missed the request.
OF_SERVERS_ALONE = "another unit"


@each_case("name", [name for name in ON_LINES if name != OF_SERVERS_ALONE])
def test_a_listener_hears(name: str) -> None:
    events, kinds = ON_LINES[name]
    assert by_listener(events) == kinds


# --- memory --------------------------------------------------------------------------------------


def test_a_response_that_comes_too_late_is_late() -> None:
    pairing = TracePairing()
    pairing.take(traced(ask(0, READ), TCP))
    pairing.tick(TIMEOUT)
    assert pairing.done == []
    pairing.tick(TIMEOUT + 1)
    pairing.take(traced(answer(TIMEOUT + 2, VALUES), TCP))
    assert [each.transaction.kind for each in pairing.done] == ["unanswered", "late"]
    assert pairing.done[1].transaction.duration == TIMEOUT + 2


def test_the_oldest_of_many_open_requests_is_given_up() -> None:
    pairing = TracePairing(timeout=math.inf)
    for number in range(MOST + 1):
        pairing.take(traced(ask(number, tcp(READ_PDU, number)), TCP))
    assert [each.transaction.time for each in pairing.done] == [0]


def test_the_oldest_of_many_connections_is_given_up() -> None:
    pairing = TracePairing(timeout=math.inf)
    for number in range(MOST_CONNECTIONS + 1):
        pairing.take(traced(ask(number, READ, f"peer {number}"), TCP))
    ((peer, done),) = pairing.done
    assert (peer, done.kind) == ("peer 0", "unanswered")


def test_connections_are_forgotten() -> None:
    pairing = TracePairing()
    tracemalloc.start()
    try:
        for number in range(3000):
            at = number * 10.0
            peer = f"peer {number}"
            for event in (ask(at, READ, peer), ask(at, READ_2, peer), answer(at, VALUES, peer)):
                pairing.take(traced(event, TCP))
            pairing.tick(at)
            pairing.done.clear()
        kept, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert kept < 200_000
