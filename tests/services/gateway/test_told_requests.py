"""
Equal requests that were sent as one: all who wait are told, once, and nothing holds them together.
"""

from __future__ import annotations

from libmodbus_py.services.gateway.line import Forwarded
from libmodbus_py.services.gateway.raw_request import request_of

READ = request_of(bytes.fromhex("03 0000 0001"))
ANSWER = bytes.fromhex("03 02 0007")


class Asker:
    """A client of a gateway, and what it was told."""

    host = "192.0.2.1"

    def __init__(self) -> None:
        self.told_of: list[tuple[Forwarded, bytes | None]] = []

    def told(self, forwarded: Forwarded, response: bytes | None) -> None:
        self.told_of.append((forwarded, response))


def asked(*askers: Asker) -> list[Forwarded]:
    """Return requests of these clients, of which the first one is sent for all."""
    first, *others = [Forwarded(each, at, 1, 1, READ, 0.0) for at, each in enumerate(askers)]
    for each in others:
        each.first = first
        first.others.append(each)
    return [first, *others]


def test_all_who_wait_are_told_once() -> None:
    askers = [Asker(), Asker(), Asker()]
    requests = asked(*askers)
    assert requests[0].tell(ANSWER) == 0
    expected = [[(each, ANSWER)] for each in requests]
    assert [each.told_of for each in askers] == expected
    assert requests[0].tell(ANSWER) == 3
    assert [each.told_of for each in askers] == expected


def test_who_is_gone_is_counted() -> None:
    askers = [Asker(), Asker(), Asker()]
    requests = asked(*askers)
    requests[0].asker = requests[2].asker = None
    assert requests[0].is_wanted
    assert requests[0].tell(None) == 2
    assert [each.told_of for each in askers] == [[], [(requests[1], None)], []]
    assert not requests[0].is_wanted


def test_one_alone_is_told() -> None:
    asker = Asker()
    (request,) = asked(asker)
    assert request.is_wanted
    assert request.tell(ANSWER) == 0
    assert asker.told_of == [(request, ANSWER)]
    assert not request.is_wanted


def test_requests_that_were_told_do_not_hold_each_other() -> None:
    first, *others = asked(Asker(), Asker(), Asker())
    first.tell(ANSWER)
    assert [each.first for each in (first, *others)] == [None] * 3
