"""
What passed at a server, as transactions: frames from the specification in, lines out.
"""

from __future__ import annotations

import pytest

from libmodbus_py import FrameError, IllegalDataAddress, InvalidResponse
from libmodbus_py.ports.trace import Traced
from libmodbus_py.tools.listener.transaction import Transaction
from libmodbus_py.tools.testing.recording import transactions_of
from tests.support.cases import each_case

TCP = "tcp://127.0.0.1:502"
LINE = "rtu:///dev/ttyUSB0"

ASKED, ANSWERED = "received", "sent"

# Messaging on TCP/IP: transaction, protocol, length, unit; then the application protocol, 6.3.
READ = "0001 0000 0006 11 03 006B 0003"
VALUES = "0001 0000 0009 11 03 06 022B 0000 0064"
REFUSED = "0001 0000 0003 11 83 02"
READ_2 = "0002 0000 0006 11 03 006B 0003"
VALUES_2 = "0002 0000 0009 11 03 06 0001 0002 0003"
OF_UNIT_18 = "0001 0000 0009 12 03 06 022B 0000 0064"
COIL = "0003 0000 0006 00 05 00AC FF00"

# Section 6.5 for unit 17 and for all, with the CRC behind (serial line, 2.5.1.2).
LINE_COIL = "11 05 00AC FF00 4E8B"
LINE_COIL_FOR_ALL = "00 05 00AC FF00 4DCA"

READ_TEXT = "ReadHoldingRegisters(address=107, count=3)"
COIL_TEXT = "WriteCoil(address=172, value=True)"


def paired(
    *passed: tuple[str, str], endpoint: str = TCP, peer: str = "127.0.0.1:5"
) -> list[Transaction]:
    return transactions_of(
        traced(direction, adu, endpoint, peer, at) for at, (direction, adu) in enumerate(passed)
    )


def traced(direction: str, adu: str, endpoint: str, peer: str, at: int = 0) -> Traced:
    data = bytes.fromhex(adu)
    unit_at = 0 if endpoint == LINE else 6
    is_frame = len(data) > 7
    unit = data[unit_at] if is_frame else None
    function = data[unit_at + 1] if is_frame else None
    return Traced(at, endpoint, direction, data, unit, function, peer)  # type: ignore[arg-type]


CASES: dict[str, tuple[list[tuple[str, str]], list[str]]] = {
    "answered": ([(ASKED, READ), (ANSWERED, VALUES)], [f"unit 17: {READ_TEXT} -> [555, 0, 100]"]),
    "refused": (
        [(ASKED, READ), (ANSWERED, REFUSED)],
        [f"unit 17: {READ_TEXT} -> illegal data address (exception 2)"],
    ),
    "no answer": ([(ASKED, READ)], [f"unit 17: {READ_TEXT} -> no answer"]),
    "several at once": (
        [(ASKED, READ), (ASKED, READ_2), (ANSWERED, VALUES), (ANSWERED, VALUES_2)],
        [f"unit 17: {READ_TEXT} -> [555, 0, 100]", f"unit 17: {READ_TEXT} -> [1, 2, 3]"],
    ),
    "the first of two unanswered": (
        [(ASKED, READ), (ASKED, READ_2), (ANSWERED, VALUES_2)],
        [f"unit 17: {READ_TEXT} -> no answer", f"unit 17: {READ_TEXT} -> [1, 2, 3]"],
    ),
    "only the beginning, after the answer of a later one": (
        [(ASKED, READ), (ASKED, READ_2), (ANSWERED, VALUES_2), (ANSWERED, VALUES[:14])],
        [
            f"unit 17: {READ_TEXT} -> damaged: 6 bytes that are not a frame",
            f"unit 17: {READ_TEXT} -> [1, 2, 3]",
        ],
    ),
    "another transaction": (
        [(ASKED, READ), (ANSWERED, VALUES_2)],
        [f"unit 17: {READ_TEXT} -> invalid: sent as unit 17, function 3, transaction 2"],
    ),
    "another unit": (
        [(ASKED, READ), (ANSWERED, OF_UNIT_18)],
        [f"unit 17: {READ_TEXT} -> invalid: sent as unit 18, function 3, transaction 1"],
    ),
    "only the beginning": (
        [(ASKED, READ), (ANSWERED, VALUES[:14])],
        [f"unit 17: {READ_TEXT} -> damaged: 6 bytes that are not a frame"],
    ),
    "no request": ([(ASKED, "00 01 00")], ["-> damaged: 3 bytes that are not a frame"]),
    "no function": (
        [(ASKED, "0001 0000 0006 11 83 006B 0003")],
        ["unit 17: -> invalid: a frame with function code 83h"],
    ),
    "an answer that nobody asked for": (
        [(ANSWERED, VALUES)],
        [r"unit 17: -> unasked: b'\x06\x02+\x00\x00\x00d'"],
    ),
    "unit 0 is one of TCP": ([(ASKED, COIL), (ANSWERED, COIL)], [f"unit 0: {COIL_TEXT} -> done"]),
}

LINES: dict[str, tuple[list[tuple[str, str]], list[str]]] = {
    "answered": (
        [(ASKED, LINE_COIL), (ANSWERED, LINE_COIL)],
        [f"unit 17: {COIL_TEXT} -> done"],
    ),
    "broadcast": ([(ASKED, LINE_COIL_FOR_ALL)], [f"unit 0: {COIL_TEXT} -> broadcast"]),
}


@each_case(("passed", "told"), CASES.values(), ids=CASES)
def test_on_tcp(passed: list[tuple[str, str]], told: list[str]) -> None:
    assert [str(each) for each in paired(*passed)] == told


@pytest.mark.parametrize(("passed", "told"), LINES.values(), ids=LINES)
def test_on_serial_lines(passed: list[tuple[str, str]], told: list[str]) -> None:
    made = paired(*passed, endpoint=LINE, peer="/dev/ttyUSB0")
    assert [str(each) for each in made] == told


def test_each_client_has_its_own_answers() -> None:
    passed = [
        (ASKED, READ, "one"),
        (ASKED, READ, "other"),
        (ANSWERED, REFUSED, "other"),
        (ANSWERED, VALUES, "one"),
    ]
    made = transactions_of(
        traced(direction, adu, TCP, peer, at) for at, (direction, adu, peer) in enumerate(passed)
    )
    assert [each.kind for each in made] == ["answered", "exception"]


def test_a_transaction_says_when_and_what() -> None:
    (made,) = paired((ASKED, READ), (ANSWERED, VALUES))
    assert (made.time, made.duration, made.unit, made.function) == (0, 1.0, 17, 3)
    assert made.response == [555, 0, 100]
    errors = [
        paired((ASKED, READ), (ANSWERED, adu))[0].error
        for adu in (REFUSED, OF_UNIT_18, VALUES[:14])
    ]
    assert list(map(type, errors)) == [IllegalDataAddress, InvalidResponse, FrameError]


def test_an_answer_may_take_as_long_as_it_likes() -> None:
    late = [traced(ASKED, READ, TCP, "one"), traced(ANSWERED, VALUES, TCP, "one", 60)]
    assert [(each.kind, each.duration) for each in transactions_of(late)] == [("answered", 60.0)]
