"""
What is known of one transaction, and the response times of a unit.
"""

import pytest

from libmodbus_py import pdu
from libmodbus_py.tools.listener.transaction import AnswerTimes, damage_alone, decoded
from tests.support.cases import each_case


@each_case(
    ("request_", "found"),
    [
        ("03 006B 0003", pdu.ReadHoldingRegisters(107, 3)),
        ("41 01", pdu.RawRequest(0x41, b"\1")),  # a function that nobody knows
        ("03 006B 0000", None),  # refused with exception 3
        ("03 006B", None),
        ("C1 01", None),  # no request has this code
    ],
)
def test_requests_that_a_server_refuses_are_none_but_for_unknown_functions(
    request_: str, found: pdu.Request[object] | None
) -> None:
    assert decoded(bytes.fromhex(request_)) == found


def test_response_times_have_a_shortest_a_mean_and_a_longest() -> None:
    times = AnswerTimes()
    assert (times.shortest, times.mean, times.longest) == (0.0, 0.0, 0.0)
    for seconds in (0.02, 0.01, 0.06):
        times.note(seconds)
    assert (times.shortest, times.longest) == (0.01, 0.06)
    assert times.mean == pytest.approx(0.03)


@each_case(
    ("data", "text"),
    [(b"\0", "a byte that is not a frame"), (b"\0\1", "2 bytes that are not a frame")],
)
def test_damage_is_told_with_its_size(data: bytes, text: str) -> None:
    assert str(damage_alone(1.0, data).error).startswith(text)
