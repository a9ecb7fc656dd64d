"""Broadcasts through a gateway: to every line, and done when all lines have sent them."""

import contextlib
from collections.abc import Iterator

import pytest

from libmodbus_py import (
    Client,
    Gateway,
    GatewayPathUnavailable,
    GatewayTargetFailedToRespond,
    IllegalFunction,
    Route,
    Server,
)
from tests.services.gateway.gates import LINE, gateway, small
from tests.simulation.lan import Lan
from tests.simulation.scripted import Scripted
from tests.support.gateways import passage
from tests.support.peers import until


@pytest.mark.parametrize("front", ["tcp", "udp", "rtu+tcp"])
def test_a_broadcast_reaches_every_unit_of_every_line(lan: Lan, front: str) -> None:
    devices = [small() for _ in range(4)]
    first, second = "rtu:///dev/first", "ascii:///dev/second"
    with (
        Server({1: devices[0], 2: devices[1]}).background(first),
        Server({3: devices[2], 4: devices[3]}).background(second),
        gateway([Route(first, "1-2"), Route(second, "3-4")], f"{front}://10.0.0.1:0") as (
            gateway_,
            url,
        ),
        Client(url, unit=0, timeout=5) as context,
    ):
        context.write_registers(2, [8, 9])
        lan.pass_time(0.1)
        assert all(device.mapping.holding_registers[2:4] == [8, 9] for device in devices)
        assert gateway_.traffic.broadcasts == 1
        if front != "rtu+tcp":  # on RTU over TCP a client expects no answer
            with pytest.raises(GatewayPathUnavailable):
                context.read_holding_registers(0, 1)


@pytest.mark.parametrize("is_there", [True, False])
def test_a_broadcast_that_a_line_refused_is_not_reported_as_sent(lan: Lan, is_there) -> None:
    if not is_there:
        lan.unreachable.add("10.0.0.9")
    with (
        gateway([Route("rtu+tcp://10.0.0.9:5020?timeout=300", "1")]) as (_, url),
        Client(url, unit=0, timeout=5000) as context,
        pytest.raises(GatewayTargetFailedToRespond),
    ):
        context.write_register(0, 1)
    assert (lan.now >= 1300) == (not is_there)


def test_a_broadcast_is_done_when_all_lines_have_sent_it(lan: Lan) -> None:
    """One sends it at once; the other, a server that takes unit 0 for one, never answers."""
    device = small()
    mute = Scripted(lan, "tcp://10.0.0.9:0", lambda request, write: None)
    with (
        Server({1: device}).background(LINE),
        gateway([Route(LINE, "1"), Route(f"{mute.url}?timeout=500", "2")]) as (_, url),
        Client(url, unit=0, timeout=5000) as context,
    ):
        start = lan.now
        with pytest.raises(GatewayTargetFailedToRespond):
            context.write_register(0, 1)
        assert lan.now - start == pytest.approx(500, abs=0.1)
        assert device.mapping.holding_registers[0] == 1
        # The unit that did not answer is paused.
        with pytest.raises(GatewayTargetFailedToRespond):
            context.write_register(0, 2)
        assert lan.now - start == pytest.approx(500, abs=0.2)
        assert device.mapping.holding_registers[0] == 2


def test_unit_0_of_a_line_may_have_a_route(lan: Lan) -> None:
    device = small()
    with (
        passage(
            "tcp", "rtu", {1: device}, route={"units": "0,7", "device_units": "0"}, lan=lan
        ) as through,
        through.context(7) as context,
    ):
        for unit in (7, 0):
            context.for_unit(unit).write_register(0, unit + 1)
            assert lan.until(lambda unit=unit: device.mapping.holding_registers[0] == unit + 1)
            with pytest.raises(GatewayTargetFailedToRespond):
                context.for_unit(unit).read_holding_registers(0, 1)


def test_the_rules_of_all_routes_of_a_line_hold_for_a_broadcast(lan: Lan) -> None:
    """It reaches the units of all of them, also of routes that come before on the same line."""
    devices = [small(), small()]
    routes = [Route(LINE, "1", read_only=True), Route(LINE, "2")]
    for order in (routes, routes[::-1]):
        with (
            Server({1: devices[0], 2: devices[1]}).background(LINE),
            gateway(order) as (gateway_, url),
            Client(url, unit=0, timeout=5) as context,
        ):
            with pytest.raises(IllegalFunction):
                context.write_register(0, 7)
            lan.pass_time(1)
            assert [device.mapping.holding_registers[0] for device in devices] == [0, 0]
            assert gateway_.traffic.broadcasts == 0


def test_a_broadcast_does_not_return_to_the_machine_that_sent_it(lan: Lan) -> None:
    """Two gateways that lead to each other would send it for ever."""
    device = small()
    writes: list[bytes] = []
    other = Scripted(lan, "tcp://10.0.0.9:0", lambda request, write: writes.append(request))
    with (
        Server({1: device}).background(LINE),
        gateway([Route(LINE, "1"), Route(other.url, "2")], "tcp://10.0.0.1:0") as (_, url),
        lan.client(url, "10.0.0.9") as gateway_there,
    ):
        write = bytes.fromhex("0007 0000 0006 00 06 0000 0007")
        gateway_there.send(write)
        assert gateway_there.receive(len(write)) == write
        lan.pass_time(1)
        assert device.mapping.holding_registers[0] == 7
        assert writes == []


@contextlib.contextmanager
def circle(line: str, *starts: str) -> Iterator[tuple[Gateway, Gateway, str]]:
    """Two gateways that lead to each other, the first one also to unit 1; and its URL."""
    with (
        gateway([Route(line, "1")], starts[0]) as (first, url),
        gateway([Route(url, "2")], starts[1]) as (second, other),
    ):
        first.change_routes([Route(line, "1"), Route(other, "2")])
        yield first, second, url


@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu+tcp"])
def test_broadcasts_do_not_loop_between_gateways(lan: Lan, scheme) -> None:
    device, start = small(), f"{scheme}://127.0.0.1:0"
    with (
        Server({1: device}).background(LINE),
        circle(LINE, start, start) as (first, second, url),
        Client(url, unit=2, timeout=20) as context,
    ):
        for value in (7, 8, 7):
            with contextlib.suppress(GatewayTargetFailedToRespond):  # the other did not forward it
                context.for_unit(0).write_register(0, value)
            lan.pass_time(0.5)
            assert device.mapping.holding_registers[0] == value
        lan.pass_time(60)
        assert (first.traffic.broadcasts, second.traffic.broadcasts) == (3, 3)
        for _ in range(3):
            with pytest.raises(GatewayTargetFailedToRespond):
                context.read_holding_registers(0, 1)
            lan.pass_time(5)
            before = first.traffic.requests, second.traffic.requests
            lan.pass_time(100)
            assert (first.traffic.requests, second.traffic.requests) == before
            assert max(before) < 23
        assert context.for_unit(1).read_holding_registers(0, 1) == [7]


def test_broadcasts_do_not_loop_between_gateways_on_unix_sockets(tmp_path):
    """All their clients have one name: that of the socket, the user and the process."""
    device, ends = small(), [f"unix://{tmp_path}/{name}" for name in "abc"]
    with (
        Server({1: device}).background(ends[0]),
        circle(*ends) as (first, second, url),
        Client(url, unit=1, timeout=20) as context,
    ):
        until(lambda: len(first.traffic.lines) == 2)
        context.write_register(3, 4)
        assert context.read_holding_registers(3, 1) == [4]
        with pytest.raises(GatewayTargetFailedToRespond):  # the other gateway did not forward it
            context.for_unit(0).write_register(0, 7)
        assert device.mapping.holding_registers[0] == 7
        assert (first.traffic.broadcasts, second.traffic.broadcasts) == (1, 1)


def test_a_broadcast_may_be_repeated_by_its_client_and_by_others_after_a_second(lan: Lan):
    write = bytes.fromhex("0007 0000 0006 00 06 0000 0007")
    busy = bytes.fromhex("0007 0000 0003 00 86 06")
    other_write = write[:-1] + b"\x08"
    with (
        Server({1: small()}).background(LINE),
        gateway([Route(LINE, "1")], "tcp://10.0.0.1:0") as (gateway_, url),
        lan.client(url) as client,
        lan.client(url) as other,
    ):
        for _ in range(3):
            client.sendall(write)
            assert client.receive(len(write)) == write
        other.sendall(write)
        assert other.receive(len(busy)) == busy
        other.sendall(other_write)
        assert other.receive(len(write)) == other_write
        lan.pass_time(1.1)
        other.sendall(write)
        assert other.receive(len(write)) == write
        assert gateway_.traffic.broadcasts == 5
