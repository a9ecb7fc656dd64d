"""
Datagrams that a gateway has answered, and waits for no more.
"""

from __future__ import annotations

import pytest

from libmodbus_py.server import udp
from tests.services.gateway.gates import small
from tests.simulation.stage import Stage
from tests.support.gateways import passage

MOST = 3


@pytest.mark.parametrize("front", ["udp", "rtu+udp"])
def test_answers_make_room_for_further_datagrams(
    stage: Stage, front: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(udp, "REMEMBERED_MAX", MOST)
    with (
        passage(front, "rtu", {1: small()}, stage=stage) as through,
        through.context(1) as client,
    ):
        for _ in range(2 * MOST):
            assert client.read_holding_registers(0, 1) == [0]
        everyone = client.for_unit(0)
        for _ in range(2 * MOST):
            everyone.write_register(0, 7)
        assert client.read_holding_registers(0, 1) == [7]
