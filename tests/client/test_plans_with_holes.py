"""Maps and plans of devices that lack some registers, on both clients: requests are counted."""

import logging
from typing import Any

import pytest

from libmodbus_py import IllegalDataAddress, ModbusTimeoutError, Plan, Point, RegisterMap
from tests.simulation.scripted import Scripted
from tests.support.clients import World
from tests.support.peers import Write, mbap

H = "holding_registers"


POINTS = RegisterMap(Point(f"p{at}", H, at) for at in range(20))


class Meter:
    """A device whose registers hold their addresses; missing ones are refused with exception 2."""

    def __init__(self, *missing: int) -> None:
        self.missing = set(missing)
        self.asked: list[tuple[int, int]] = []
        self.silent: set[int] = set()

    def __call__(self, request: bytes, write: Write) -> None:
        address, count = (int.from_bytes(request[at : at + 2], "big") for at in (8, 10))
        self.asked.append((address, count))
        cells = range(address, address + count)
        if self.silent & set(cells):
            return
        if self.missing & set(cells):
            write(mbap(request, b"\x83\x02"))
            return
        data = b"".join(cell.to_bytes(2, "big") for cell in cells)
        write(mbap(request, bytes([3, len(data)]) + data))

    def taken(self) -> int:
        """Return the number of requests since the last call."""
        count = len(self.asked)
        self.asked.clear()
        return count


def values(*missing: int) -> dict[str, int]:
    return {f"p{at}": at for at in range(20) if at not in missing}


def good(results: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in results.items() if not isinstance(value, Exception)}


def test_a_refused_register_costs_ten_requests_once(world: World) -> None:
    device = Meter(7)
    with world.client_of("tcp", device) as plc:
        counts = []
        for _ in range(10):
            results = plc.read_map(POINTS, return_exceptions=True)
            assert good(results) == values(7)
            assert isinstance(results["p7"], IllegalDataAddress)
            counts.append(device.taken())
        assert counts[0] <= 1 + 10
        assert counts[1:] == [2] * 9
        (hole,) = plc.unreadable(POINTS)
        assert (hole.name, hole.table, hole.cells) == ("p7", H, range(7, 8))
        assert hole.device == f"{plc.url}, unit {plc.unit}"
        # The refusals are used for other names of the same map.
        results = plc.read_map(POINTS, ["p6", "p7", "p8"], return_exceptions=True)
        assert good(results) == {"p6": 6, "p8": 8}
        assert device.taken() == 2


def test_an_empty_plan_is_read_without_a_request(world: World) -> None:
    with world.client_of("tcp", Meter(7)) as plc:
        plc.read_map(POINTS, return_exceptions=True)
        assert plc.read_many(Plan([])) == plc.read_many(Plan([]), return_exceptions=True) == []


def test_without_return_exceptions_the_point_is_named(world: World) -> None:
    device = Meter(7, 12)
    with world.client_of("tcp", device) as plc:
        for most in (1 + 6, 2, 2):
            with pytest.raises(IllegalDataAddress, match=r"p7: illegal data address") as caught:
                plc.read_map(POINTS)
            assert caught.value.names == ("p7",)
            assert device.taken() <= most
        device.missing.clear()
        assert plc.read_map(POINTS) == values()
        assert device.taken() == 1


def test_a_refused_register_is_found_although_another_request_succeeds(world: World) -> None:
    points = RegisterMap([Point("far", H, 900), *(Point(f"p{at}", H, at) for at in range(20))])
    device = Meter(7)
    with world.client_of("tcp", device) as plc:
        results = plc.read_map(points, return_exceptions=True)
        assert good(results) == {"far": 900, **values(7)}


def test_nothing_more_is_sent_after_the_first_failure(world: World) -> None:
    points = RegisterMap([Point("a", H, 0), Point("b", H, 10), Point("c", H, 20)])
    device = Meter(10)
    with world.client_of("tcp", device) as plc:
        with pytest.raises(IllegalDataAddress):
            plc.read_map(points)
        assert device.asked == [(0, 1), (10, 1)]


def test_a_plan_keeps_the_refusals_of_each_device_apart(world: World) -> None:
    plan = Plan({f"p{at}": (H, at) for at in range(20)})
    one, other = Meter(7), Meter(11)
    with (
        world.client_of("tcp", one) as first,
        world.connect(Scripted(world.network, "tcp://10.0.0.2", other).url) as second,
    ):
        for _ in range(3):
            assert len(good(first.read_many(plan, return_exceptions=True))) == 19
            assert isinstance(second.read_many(plan, return_exceptions=True)["p11"], Exception)
        # Another handle of the unit has the refusals, and another unit does not.
        one.taken()
        first.for_unit(1).read_many(plan, return_exceptions=True)
        assert one.taken() == 2
        ninth = first.for_unit(9)
        assert ninth.unreadable(plan) == []
        ninth.read_many(plan, return_exceptions=True)
        assert one.taken() > 2
        messages = [
            (name.device, name.name)
            for client in (first, ninth, second)
            for name in client.unreadable(plan)
        ]
        assert messages == [
            (f"{first.url}, unit 1", "p7"),
            (f"{first.url}, unit 9", "p7"),
            (f"{second.url}, unit 1", "p11"),
        ]


def test_another_client_has_no_refusals_of_the_first_one(world: World) -> None:
    """A map and a plan do not change because of the answers to one client."""
    device = Meter(7)
    peer = world.peer("tcp", device)
    with world.connect(peer.url) as plc:
        plc.read_map(POINTS, return_exceptions=True)
        assert [name.name for name in plc.unreadable(POINTS)] == ["p7"]
    device.missing.clear()
    device.taken()
    with world.connect(peer.url) as plc:
        assert plc.read_map(POINTS, return_exceptions=True) == values()
        assert device.taken() == 1
        assert plc.unreadable(POINTS) == []


def test_only_plans_and_maps_have_unreadable_items(world: World) -> None:
    with (
        world.client_of("tcp", Meter()) as plc,
        pytest.raises(TypeError, match="what must be a RegisterMap or a Plan, not list"),
    ):
        plc.unreadable([(H, 0)])


def test_items_that_are_no_plan_are_read_as_they_are(world: World) -> None:
    device = Meter(7)
    with world.client_of("tcp", device) as plc:
        outcomes = plc.read_many([(H, at) for at in range(20)], return_exceptions=True)
        assert all(isinstance(outcome, IllegalDataAddress) for outcome in outcomes)
        assert device.taken() == 1


def test_silence_is_not_taken_for_a_refusal(world: World) -> None:
    device = Meter()
    device.silent.add(7)
    with world.client_of("tcp", device, timeout=0.5) as plc:
        for _ in range(3):
            results = plc.read_map(POINTS, return_exceptions=True)
            assert all(isinstance(result, ModbusTimeoutError) for result in results.values())
            assert device.taken() == 1


def test_refusals_are_logged_once(world: World, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "libmodbus_py.client.handle")
    with world.client_of("tcp", Meter(7)) as plc:
        for _ in range(3):
            plc.read_map(POINTS, return_exceptions=True)
        assert caplog.messages == [
            f"{plc.url}, unit 1: cannot be read: p7, holding_registers 7 (1 register): "
            "illegal data address (exception 2)"
        ]
