"""
Blocking clients whose end of a request is itself interrupted: the next request does what remains.
"""

from __future__ import annotations

from typing import Any

import pytest

from libmodbus_py import Context, ModbusConnectionError, State
from tests.support.peers import answer, peer_at


class Interrupted:
    """Raises KeyboardInterrupt in place of a method, so many times."""

    def __init__(self, patch: pytest.MonkeyPatch, owner: Any, name: str, times: int = 1) -> None:
        self._method, self._left = getattr(owner, name), times
        patch.setattr(owner, name, self)

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        self._left -= 1
        if self._left >= 0:
            raise KeyboardInterrupt
        return self._method(*arguments, **options)


@pytest.mark.parametrize("native", [True, False])
def test_the_connection_is_left_by_the_next_request(
    native: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with (
        peer_at("tcp", lambda request, write: write(answer(request, "tcp"))) as peer,
        Context.from_url(peer.url, native=native) as context,
    ):
        assert context.read_holding_registers(6, 1) == [6]
        driver = context._driver
        Interrupted(monkeypatch, driver, "_step")
        Interrupted(monkeypatch, driver._connection, "interrupted")
        with pytest.raises(KeyboardInterrupt):
            context.read_holding_registers(7, 1)
        assert context.read_holding_registers(8, 1) == [8]
        assert context.state is State.CONNECTED
        assert context.statistics.connects == 2


@pytest.mark.parametrize("native", [True, False])
def test_a_client_that_was_closed_meanwhile_is_closed_by_the_next_request(
    native: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    with peer_at("tcp", lambda request, write: write(answer(request, "tcp"))) as peer:
        context = Context.from_url(peer.url, native=native)
        assert context.read_holding_registers(6, 1) == [6]
        Interrupted(monkeypatch, context._driver, "_shut")
        with pytest.raises(KeyboardInterrupt):
            context.close()
        with pytest.raises(ModbusConnectionError, match="closed"):
            context.read_holding_registers(7, 1)
        assert context.state is State.CLOSED
        assert len(peer.requests) == 1
        context.close()
