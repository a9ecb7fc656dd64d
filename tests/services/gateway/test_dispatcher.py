"""Which line a request goes to, and under which unit."""

import pytest

from libmodbus_py import (
    Client,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalDataAddress,
    Route,
    Server,
)
from libmodbus_py.server import udp
from tests.services.gateway.gates import LINE, READ_ONE, adu, gated, gateway, numbered, small
from tests.simulation.lan import Lan
from tests.support.gateways import passage


def test_units_have_other_numbers_on_their_lines(lan: Lan) -> None:
    with (
        Server({n: numbered(n) for n in (1, 2, 3)}).background("tcp://10.0.0.9:0") as one,
        Server({n: numbered(100 + n) for n in (1, 7)}).background(LINE),
        gateway(
            [
                Route(one.urls[0], "1-2"),
                Route(f"{LINE}?timeout=300", "11-17", "1-7"),
                Route(one.urls[0], [20, 21], 3),
            ]
        ) as (gateway_, url),
        Client(url, timeout=2000) as context,
    ):

        def ask(unit: int) -> int:
            return context.for_unit(unit).read_holding_registers(0, 1)[0]

        assert [ask(unit) for unit in (1, 2, 11, 17, 20, 21)] == [1, 2, 101, 107, 3, 3]
        for unit in (3, 10, 18, 22, 0, 247):
            with pytest.raises(GatewayPathUnavailable):
                ask(unit)
        start = lan.now
        with pytest.raises(GatewayTargetFailedToRespond):
            ask(12)
        assert lan.now - start == pytest.approx(300, abs=0.1)
        assert gateway_.traffic.no_route == 6
        assert len(gateway_.traffic.lines) == 2  # routes with one URL share its connection


def test_the_gateway_itself_is_unit_255_with_its_statistics(lan: Lan) -> None:
    with passage("tcp", "rtu", {1: small()}, lan=lan) as through, through.context(1) as context:
        for _ in range(3):
            context.read_holding_registers(0, 1)
        own = context.for_unit(255)
        assert own.read_input_registers(6, 4) == [0, 1, 0, 4]  # connections, and requests
        assert own.read_input_registers(1000 + 20, 4) == [0, 3, 0, 3]  # of unit 1, and answers
        assert own.read_input_registers(1000 + 40, 2) == [0, 0]
        assert own.read_device_identification().names["ProductCode"] == "Gateway"


def test_unit_255_may_have_a_route_beside_own_units(lan: Lan) -> None:
    with (
        Server({255: numbered(7)}).background("tcp://10.0.0.9:0") as behind,
        gateway([Route(behind.urls[0], "255")], own_units=[0, 250]) as (_, url),
        Client(url) as context,
    ):
        assert context.for_unit(255).read_holding_registers(0, 1) == [7]
        for unit in (0, 250):
            assert context.for_unit(unit).read_input_registers(1, 1) == [1]


def test_on_a_line_the_gateway_answers_its_units_and_leaves_others_to_their_devices(lan: Lan):
    """The answer to a write looks like the write, and so does the same write again."""
    device = small()
    with (
        Server({1: small()}).background("tcp://10.0.0.9:0") as behind,
        gateway([Route(behind.urls[0], "1")], LINE, own_units=[250]) as (gateway_, _),
        Server({7: device}).background(LINE),
        Client(LINE, unit=7) as context,
    ):
        for _ in range(2):
            context.write_register(0, 5)
        assert device.mapping.holding_registers[0] == 5
        assert (gateway_.traffic.requests, gateway_.traffic.no_route) == (2, 2)
        for _ in range(2):
            context.for_unit(1).write_register(0, 5)
        for _ in range(2):
            with pytest.raises(IllegalDataAddress):
                context.for_unit(250).write_register(0, 5)
        assert (gateway_.traffic.requests, gateway_.traffic.no_route) == (6, 2)


@pytest.mark.parametrize("error", [SystemExit, KeyboardInterrupt])
def test_a_rule_that_ends_the_program_ends_the_gateway(lan: Lan, error: type[BaseException]):
    def authorize(request: object) -> bool:
        raise error

    def ask() -> None:
        with (
            gateway([Route(LINE, "1")], "tcp://10.0.0.1:0", authorize=authorize) as (_, url),
            lan.client(url) as client,
        ):
            client.sendall(adu(READ_ONE))
            assert client.receive(1) == b""

    with pytest.raises(error):
        ask()


@pytest.mark.parametrize(("writes_first", "place"), [(True, 1), (False, 6)])
def test_writes_overtake_reads_with_the_option(lan: Lan, writes_first: bool, place: int) -> None:
    with gated(lan, writes_first=writes_first) as (gate, line, url, _), lan.client(url) as client:
        client.sendall(adu(READ_ONE) * 6 + adu(bytes.fromhex("06 0000 0001"), 9))
        assert lan.until(lambda: line.waiting == 6)
        gate.open()
        client.receive(6 * 11 + 12)
        assert gate.kinds.index("write") == place


MOST = 3


@pytest.mark.parametrize("front", ["udp", "rtu+udp"])
def test_each_answer_allows_another_datagram(lan: Lan, front, monkeypatch) -> None:
    monkeypatch.setattr(udp, "REMEMBERED_MAX", MOST)
    with passage(front, "rtu", {1: small()}, lan=lan) as through, through.context(1) as client:
        for _ in range(2 * MOST):
            assert client.read_holding_registers(0, 1) == [0]
        everyone = client.for_unit(0)
        for _ in range(2 * MOST):
            everyone.write_register(0, 7)
        assert client.read_holding_registers(0, 1) == [7]
