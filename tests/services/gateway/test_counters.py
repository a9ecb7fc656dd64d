"""Every counter of a gateway: what happens counts once, and nothing else does."""

import logging
from dataclasses import fields
from typing import Any, NamedTuple

import pytest

from libmodbus_py import Gateway, IllegalDataAddress, Route
from libmodbus_py.serve import ClientRequest
from tests.services.gateway.gates import LINE, adu
from tests.simulation.lan import Lan
from tests.simulation.scripted import Scripted, Write
from tests.support.driver import rtu

READ, WRITE = "03 0000 0001", "06 0001 0007"

ANSWERS, SILENT, REFUSES, DAMAGES = 1, 2, 3, 4  # what the units on the line do

DELAY = 0.1


class Case(NamedTuple):
    """
    Requests, and what they count. `asked`: unit and request of each; they are sent together, or
    else one after the other; `answers`: the function and the second byte of each answer, in
    hexadecimal; `gateway, line`: what of their counters is not 0 afterwards; `units`: the same for
    each unit of the line; `options`: of the gateway, and `route` of its route.
    """

    asked: list[tuple[int, str]]
    answers: list[str]
    gateway: dict[str, int]
    units: dict[int, dict[str, int]] = {}  # noqa: RUF012
    line: dict[str, int] = {}  # noqa: RUF012
    options: dict[str, Any] = {}  # noqa: RUF012
    together: bool = False


def refusing(request: ClientRequest) -> None:
    raise IllegalDataAddress("not here", function=request.function)


def failing(request: ClientRequest) -> None:
    raise ZeroDivisionError


def no(request: ClientRequest) -> bool:
    return False


CASES = {
    "a read": Case([(1, READ)], ["0302"], {"requests": 1}, {1: {"requests": 1, "answers": 1}}),
    "an exception": Case(
        [(3, READ)], ["8302"], {"requests": 1}, {3: {"requests": 1, "answers": 1, "exceptions": 1}}
    ),
    "silence, and another request": Case(
        [(2, READ), (2, READ)],
        ["830b", "830b"],
        {"requests": 2},
        {2: {"requests": 1, "timeouts": 1, "refused": 1, "is_silent": True}},
    ),
    "requests that waited for a silent unit": Case(
        [(2, READ), (2, READ), (2, "04 0000 0001")],
        ["830b", "840b", "830b"],
        {"requests": 3},
        {2: {"requests": 1, "timeouts": 1, "refused": 2, "is_silent": True}},
        together=True,
    ),
    "a damaged answer": Case(
        [(4, READ)], ["830b"], {"requests": 1}, {4: {"requests": 1, "invalid": 1}}
    ),
    "no route": Case([(9, READ)], ["830a"], {"requests": 1, "no_route": 1}),
    "a write where only reads may pass": Case(
        [(1, WRITE)],
        ["8601"],
        {"requests": 1, "refused": 1},
        options={"route": {"read_only": True}},
    ),
    "what authorize forbids": Case(
        [(1, READ)], ["8301"], {"requests": 1, "refused": 1}, options={"authorize": no}
    ),
    "what authorize refuses": Case(
        [(1, READ)], ["8302"], {"requests": 1}, options={"authorize": refusing}
    ),
    "what authorize fails on": Case(
        [(1, READ), (1, READ)], ["8304"] * 2, {"requests": 2}, options={"authorize": failing}
    ),
    "no function": Case([(1, "00")], ["8001"], {"requests": 1, "malformed": 1}),
    "no whole request": Case([(1, "03 0000")], ["8303"], {"requests": 1, "malformed": 1}),
    "an answer": Case(
        [(1, "83 02"), (1, READ)], ["0302"], {"requests": 2}, {1: {"requests": 1, "answers": 1}}
    ),
    "a broadcast": Case(
        [(0, WRITE)], ["0600"], {"requests": 1, "broadcasts": 1}, {0: {"requests": 1}}
    ),
    "a read of all units": Case([(0, READ)], ["830a"], {"requests": 1, "no_route": 1}),
    "a cached read": Case(
        [(1, READ)] * 3,
        ["0302"] * 3,
        {"requests": 3},
        {1: {"requests": 1, "answers": 1, "cached": 2}},
        options={"route": {"cache": 60}},
    ),
    "reads that joined one that waited": Case(
        [(1, READ)] * 4,
        ["0302"] * 4,
        {"requests": 4},
        {1: {"requests": 2, "answers": 2, "merged": 2}},
        options={"route": {"merge": True}},
        together=True,
    ),
    "a full queue": Case(
        [(1, WRITE)] * 4,
        ["8606", "8606", "0600", "0600"],
        {"requests": 4},
        {1: {"requests": 2, "answers": 2}},
        {"full": 2},
        {"queue": 1},
        together=True,
    ),
    "more of one client than may be unanswered": Case(  # twice the queue, and 16
        [(1, READ)] * 20,
        ["8306", "8306", *["0302"] * 18],
        {"requests": 20},
        {1: {"requests": 2, "answers": 2, "merged": 16}},
        {"full": 2},
        {"queue": 1, "route": {"merge": True}},
        together=True,
    ),
    "a wait that is too long": Case(
        [(1, WRITE)] * 3,
        ["0600", "0600", "8606"],
        {"requests": 3},
        {1: {"requests": 2, "answers": 2}},
        {"full": 1},
        {"longest_wait": 3.5 * DELAY},
        together=True,
    ),
    "the gateway itself": Case([(255, "04 0000 0002")], ["0404"], {"requests": 1}),
}


def counted(statistics: Any, *left_out: str) -> dict[str, int]:
    """Return the counters that are not 0."""
    left_out += "url", "connection", "units", "lines", "seconds", "since"
    counts = {field.name: getattr(statistics, field.name) for field in fields(statistics)}
    return {name: value for name, value in counts.items() if value and name not in left_out}


def answer(request: bytes, write: Write) -> None:
    unit, body = request[0], request[1:-2]
    if unit in (0, SILENT):
        return
    pdu = bytes([3, 2, 0, 7]) if body[0] == 3 else body
    if unit == REFUSES:
        pdu = bytes([body[0] | 0x80, 2])
    frame = rtu(bytes([unit, *pdu]).hex())
    write(frame[:-1] + bytes([frame[-1] ^ (unit == DAMAGES)]), DELAY)


@pytest.mark.parametrize("name", CASES)
def test_each_request_counts_once(lan: Lan, name, caplog) -> None:
    case = CASES[name]
    Scripted(lan, LINE, answer)
    options = {**case.options}
    route = Route(f"{LINE}?timeout=0.5", units="1-4", **options.pop("route", {}))
    gateway = Gateway([route], **options)
    caplog.set_level(logging.ERROR)
    answers: list[str] = []
    with gateway.background("tcp://10.0.0.1:0") as running, lan.client(running.urls[0]) as client:

        def receive() -> None:
            lan.pass_time(0.6 if not case.together else 10)
            while client.has_input():
                head = client.receive(6)
                answers.append(client.receive(head[5])[1:3].hex())

        for unit, request in case.asked:
            client.sendall(adu(bytes.fromhex(request), unit=unit))
            if not case.together:
                receive()
        receive()
        (line,) = gateway.traffic.lines.values()
        assert answers == case.answers
        assert counted(gateway.traffic) == case.gateway
        assert counted(line) == case.line
        assert {unit: counted(entry) for unit, entry in line.units.items() if counted(entry)} == (
            case.units
        )
        for unit in line.units.values():
            # The first answer of a line is held for twice its time.
            assert 0.8 <= unit.seconds / (DELAY * unit.answers or 1.0) <= 3.4 or not unit.answers
        refused = sum(answer.startswith("8") for answer in answers)
        assert gateway.statistics.refused == refused
        assert gateway.statistics.unauthorized == (case.options.get("authorize") is no)
        assert len(caplog.messages) == (case.options.get("authorize") is failing)
