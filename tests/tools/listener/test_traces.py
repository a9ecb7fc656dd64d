"""
Which answer belongs to which request of a trace, for the page, the pytest plugin and scans.

Frames are those of the specification (messaging on TCP/IP, 3.1.3; application protocol, 6.3 and
6.5; serial line, 2.5.1.2), or carry check bytes that talk.py computes.
"""

import math
import tracemalloc
from typing import NamedTuple

from libmodbus_py.listen import Separator
from libmodbus_py.ports.trace import TracedFrame
from libmodbus_py.tools.listener.pairing import MOST, MOST_CONNECTIONS, TIMEOUT, TracePairing
from libmodbus_py.tools.listener.transaction import Transaction
from tests.support.cases import each_case
from tests.support.driver import rtu

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


def damage(at: float, direction: str = "sent") -> Event:
    return Event(at, direction, b"\0\1\0", is_frame=False)


READ, READ_2, COIL = tcp(READ_PDU), tcp(READ_PDU, 2), tcp(COIL_PDU)
VALUES, VALUES_2, REFUSAL = tcp(VALUES_PDU), tcp(VALUES_PDU, 2), tcp("83 02")

# Events, and how the transactions end, in the order in which they began.
ON_TCP: list[tuple[list[Event], str]] = [
    ([ask(0, READ), answer(1, VALUES)], "17:3 answered"),
    ([ask(0, READ), answer(4, VALUES)], "17:3 answered"),
    ([ask(0, READ), answer(1, REFUSAL)], "17:3 exception"),
    ([ask(0, READ)], "17:3 unanswered"),
    ([ask(0, READ), ask(1, READ_2), answer(2, VALUES_2)], "17:3 unanswered, 17:3 answered"),
    # several at once, also with the last answered first
    ([ask(0, READ), ask(0.1, READ_2), answer(0.2, VALUES), answer(0.3, VALUES_2)],
     "17:3 answered, 17:3 answered"),
    ([ask(0, READ), ask(0.1, READ_2), answer(0.2, VALUES_2), answer(0.3, VALUES)],
     "17:3 answered, 17:3 answered"),
    # the same id again, also for another request
    ([ask(0, READ), ask(1, READ), answer(2, VALUES)], "17:3 unanswered, 17:3 answered"),
    ([ask(0, READ), ask(1, COIL), answer(2, COIL)], "17:3 unanswered, 17:5 answered"),
    # answered twice, also within the next one
    ([ask(0, READ), answer(1, VALUES), answer(2, VALUES)], "17:3 answered, 17:3 unasked"),
    ([ask(0, READ), answer(1, VALUES), ask(2, READ_2), answer(2, VALUES), answer(2, VALUES_2)],
     "17:3 answered, 17:3 unasked, 17:3 answered"),
    ([answer(0, VALUES)], "17:3 unasked"),
    # a response with another transaction, unit, function or count
    ([ask(1, READ_2), answer(2, VALUES)], "17:3 invalid"),
    ([ask(0, READ), answer(1, tcp(VALUES_PDU, unit=18))], "17:3 invalid"),
    ([ask(0, READ), answer(1, tcp("04 06 022B 0000 0064"))], "17:3 invalid"),
    ([ask(0, READ), answer(1, tcp("03 02 022B"))], "17:3 invalid"),
    # damage belongs to the last open request, unless its answer follows
    ([ask(0, READ), damage(1)], "17:3 damaged"),
    ([ask(0, READ), ask(1, READ_2), damage(1)], "17:3 unanswered, 17:3 damaged"),
    ([ask(0, READ), ask(0.1, READ_2), damage(1), answer(1, VALUES_2)],
     "17:3 unanswered, 17:3 answered, damaged"),
    ([damage(0, "received")], "damaged"),
    ([ask(0, tcp("83 006B 0003"))], "17:None invalid"),
    # unit 0 is no broadcast, and some requests demand silence
    ([ask(0, tcp(COIL_PDU, unit=0)), answer(1, tcp(COIL_PDU, unit=0))], "0:5 answered"),
    ([ask(0, tcp("08 0004 0000"))], "17:8 broadcast"),
    # several clients, also one that has closed its connection
    ([ask(0, READ), ask(0.1, READ, "other"), answer(1, REFUSAL, "other"), answer(2, VALUES)],
     "17:3 answered, 17:3 exception"),
    ([ask(0, READ), ask(1, READ, "other"), answer(2, VALUES, "other")],
     "17:3 unanswered, 17:3 answered"),
]  # fmt: skip

ASK, ANSWER = line(READ_PDU), line(VALUES_PDU)
WRITE, WRITE_ALL = line(COIL_PDU), line(COIL_PDU, 0)
ASK_18, ANSWER_18 = line(READ_PDU, 18), line(VALUES_PDU, 18)

ON_LINES: list[tuple[list[Event], str]] = [
    ([ask(0, ASK), answer(1, ANSWER)], "17:3 answered"),
    ([ask(0, WRITE), answer(1, WRITE)], "17:5 answered"),
    ([ask(0, WRITE_ALL)], "0:5 broadcast"),
    ([ask(0, ASK), ask(1, ASK), answer(2, ANSWER)], "17:3 unanswered, 17:3 answered"),
    ([ask(0, ASK), ask(1, ASK), answer(2, ANSWER), answer(3, ANSWER)],
     "17:3 unanswered, 17:3 answered, 17:3 unasked"),
    ([ask(0, ASK), ask(1, ASK_18), answer(2, ANSWER_18)], "17:3 unanswered, 18:3 answered"),
    ([ask(0, ASK), ask(1, ASK_18), answer(2, ANSWER), answer(3, ANSWER_18)],
     "17:3 unanswered, 17:3 late, 18:3 answered"),
    ([ask(0, ASK), damage(1)], "17:3 damaged"),
    ([ask(0, ASK), damage(1), answer(1, ANSWER)], "17:3 answered, damaged"),
    ([ask(0, ASK), answer(1, ANSWER), damage(1)], "17:3 answered, damaged"),
]  # fmt: skip


def traced(event: Event, endpoint: str) -> TracedFrame:
    at = 6 if endpoint == TCP else 0
    unit, function = event.adu[at : at + 2] if event.is_frame else (None, None)
    direction = event.direction
    return TracedFrame(event.at, endpoint, direction, event.adu, unit, function, event.peer)  # type: ignore[arg-type]


def texts(transactions: list[Transaction]) -> str:
    transactions = sorted(transactions, key=lambda each: each.time)
    where = ["" if item.unit is None else f"{item.unit}:{item.function} " for item in transactions]
    return ", ".join(f"{place}{item.kind}" for place, item in zip(where, transactions, strict=True))


def paired(events: list[Event], endpoint: str) -> str:
    pairing = TracePairing()
    for event in events:
        pairing.take(traced(event, endpoint))
    pairing.end()
    return texts([exchange.transaction for exchange in pairing.done])


@each_case(("events", "kinds"), ON_TCP)
def test_a_trace_on_tcp_becomes_transactions(events: list[Event], kinds: str) -> None:
    assert paired(events, TCP) == kinds


@each_case(("events", "kinds"), [*ON_LINES, ([ask(0, ASK), answer(1, ANSWER_18)], "17:3 invalid")])
def test_a_trace_on_a_line_becomes_transactions(events: list[Event], kinds: str) -> None:
    assert paired(events, LINE) == kinds


@each_case(("events", "kinds"), ON_LINES)
def test_a_listener_on_both_sides_reports_the_same_transactions(events: list[Event], kinds: str):
    separator, transactions = Separator("rtu"), []
    for at, direction, adu, _, _ in events:
        transactions += separator.feed(adu, at, "client" if direction == "received" else "server")
    assert texts(transactions + separator.end()) == kinds


def test_a_late_response_is_marked_as_late() -> None:
    pairing = TracePairing()
    pairing.take(traced(ask(0, READ), TCP))
    pairing.tick(TIMEOUT)
    assert pairing.done == []
    pairing.tick(TIMEOUT + 1)
    pairing.take(traced(answer(TIMEOUT + 2, VALUES), TCP))
    assert [exchange.transaction.kind for exchange in pairing.done] == ["unanswered", "late"]
    assert pairing.done[1].transaction.duration == TIMEOUT + 2


def test_the_oldest_of_too_many_requests_or_connections_is_dropped() -> None:
    requests, connections = TracePairing(timeout=math.inf), TracePairing(timeout=math.inf)
    for number in range(MOST + 1):
        requests.take(traced(ask(number, tcp(READ_PDU, number)), TCP))
    for number in range(MOST_CONNECTIONS + 1):
        connections.take(traced(ask(number, READ, f"peer {number}"), TCP))
    assert [request.transaction.time for request in requests.done] == [0]
    assert [exchange.peer for exchange in connections.done] == ["peer 0"]


def test_connections_are_forgotten() -> None:
    pairing = TracePairing()
    tracemalloc.start()
    try:
        for number in range(3000):
            at, peer = number * 10.0, f"peer {number}"
            for event in (ask(at, READ, peer), ask(at, READ_2, peer), answer(at, VALUES, peer)):
                pairing.take(traced(event, TCP))
            pairing.tick(at)
            pairing.done.clear()
        memory, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert memory < 200_000
