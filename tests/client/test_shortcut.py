"""
Single requests that a context carries the short way, until something else happens.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Context, IllegalDataAddress, pdu
from tests.support.peers import Write, answer, mbap, peer_at


def refusing_address_9(request: bytes, write: Write) -> None:
    is_refused = request[8:10] == b"\0\x09"
    write(mbap(request, b"\x83\x02") if is_refused else answer(request, "tcp"))


@pytest.mark.parametrize("native", [True, False])
def test_a_request_that_was_handed_over_counts_once_though_the_next_one_is_interrupted(
    native: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The conversation gets what is refused, so that the trace contains all requests."""

    def interrupted() -> int:
        raise KeyboardInterrupt

    with (
        peer_at("tcp", refusing_address_9) as peer,
        Context.from_url(peer.url, native=native) as context,
    ):
        with pytest.raises(IllegalDataAddress):
            context.read_holding_registers(9, 1)
        with monkeypatch.context() as patch:
            patch.setattr(context._driver._shortcut._matching, "next_number", interrupted)
            with pytest.raises(KeyboardInterrupt):
                context.read_holding_registers(7, 1)
        assert context.read_holding_registers(8, 1) == [8]
        assert context.statistics.results == {(3, "ok"): 1, (3, "exception"): 1}
        assert context.statistics.requests == 2


class Mistaken(pdu.ReadHoldingRegisters):
    """A class with a mistake."""

    def _decode_response(self, data: bytes) -> Any:
        raise ZeroDivisionError


@pytest.mark.parametrize("native", [True, False])
def test_a_request_whose_class_has_a_mistake_is_over(native: bool) -> None:
    with (
        peer_at("tcp", refusing_address_9) as peer,
        Context.from_url(peer.url, native=native) as context,
    ):
        with pytest.raises(ZeroDivisionError):
            context.execute(Mistaken(7, 1))
        assert context.statistics.results == {(3, "invalid"): 1}
        assert context.read_holding_registers(8, 1) == [8]
        assert context.statistics.requests == 2
        assert len(peer.requests) == 2
