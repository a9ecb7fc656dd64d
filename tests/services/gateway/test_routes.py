"""Which units go where, and what a route lets through."""

import socket
from pathlib import Path

import pytest

from libmodbus_py import Route
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.services.gateway.config import parse as parse_file
from libmodbus_py.services.gateway.routes import check_line
from tests.support.golden import Refused

TCP, LINE = "tcp://192.0.2.1", "rtu:///dev/ttyUSB0"


@pytest.mark.parametrize(
    ("url", "units"),
    [
        (TCP, range(255)),
        ("udp://192.0.2.1", range(255)),
        (LINE, range(1, 248)),
        ("rtu+tcp://192.0.2.1", range(1, 248)),
        ("ascii:///dev/ttyUSB0", range(1, 248)),
    ],
)
def test_a_route_has_the_units_that_exist_on_its_line(url: str, units: range) -> None:
    route = Route(url)
    assert route.units == tuple(units)
    assert route.ways == {unit: unit for unit in units}


@pytest.mark.parametrize(
    ("units", "device_units", "ways"),
    [
        ("1-3", None, {1: 1, 2: 2, 3: 3}),
        ("1-3", 9, {1: 9, 2: 9, 3: 9}),
        ("1-3", "11-13", {1: 11, 2: 12, 3: 13}),
        ([5, 7], [7, 5], {5: 7, 7: 5}),
        ([5, 7], [2, 2], {5: 2, 7: 2}),
        ([0, 255], None, {0: 0, 255: 255}),
        ("4", [1], {4: 1}),
    ],
)
def test_units_may_have_other_numbers_on_the_line(units, device_units, ways) -> None:
    assert Route(TCP, units, device_units).ways == ways


def test_routes_with_equal_units_are_equal() -> None:
    routes = [Route(TCP, "1-3", entry) for entry in ("11-13", [11, 12, 13], iter((11, 12, 13)))]
    assert [route.device_units for route in routes] == [(11, 12, 13)] * 3
    assert routes[0] == routes[1] == routes[2]


def test_a_wrong_route_is_named(refused: Refused) -> None:
    refused("wrong_routes.txt", lambda options: Route(TCP, **options))


def test_a_read_only_route_forwards_only_reads() -> None:
    """By the functions of the specification (6.7 to 6.13 and 6.21)."""
    allow = Route(TCP, read_only=True).allow
    assert allow is not None
    counters = {f"8/{number}" for number in range(11, 19)}
    assert set(allow.functions) == {7, 11, 12, 17, "43/14", "8/0", "8/2"} | counters
    assert not allow.write


def test_the_writable_ranges_of_a_route_are_those_of_its_argument() -> None:
    assert Route(TCP, writable="all").writable == "all"
    some = Route(TCP, writable=["coils"])
    assert some.allow is not None
    assert some.writable == some.allow.write
    assert "7" not in map(str, some.writable or ())


@pytest.mark.parametrize("text", ["", "route = []", "route = 1", "route = [1]"])
def test_a_file_without_routes_is_refused(text: str) -> None:
    with pytest.raises((TypeError, ValueError), match="route"):
        parse_file(text)


def leads_back(line: str, listening: str) -> bool:
    try:
        check_line("to", parse(line), [parse(listening)])
    except ValueError as error:
        return "to: the gateway itself listens on" in str(error)
    return False


@pytest.mark.parametrize(
    ("line", "listening", "is_own"),
    [
        ("tcp://127.0.0.1:1502", "tcp://127.0.0.1:1502", True),
        ("tcp://127.0.0.1:1502", "tcp://127.0.0.1:1503", False),
        ("udp://127.0.0.1:1502", "tcp://127.0.0.1:1502", False),
        ("tcp://127.0.0.1:1502", "udp://127.0.0.1:1502", False),
        ("udp://127.0.0.1:1502", "udp://127.0.0.1:1502", True),
        ("udp://127.0.0.1:1502", "udp://[::]:1502", True),
        ("tcp://127.0.0.1:802", "tls://127.0.0.1:802", True),
        ("rtu+tcp://127.0.0.1:1502", "tcp://127.0.0.1:1502", True),
        ("tcp://localhost:1502", "tcp://127.0.0.1:1502", True),
        ("tcp://[::1]:1502", "tcp://127.0.0.1:1502", True),
        ("tcp://127.0.0.9:1502", "tcp://0.0.0.0:1502", True),
        ("tcp://[::1]:1502", "tcp://[::]:1502", True),
        ("tcp://192.0.2.1:1502", "tcp://127.0.0.1:1502", False),
        ("tcp://192.0.2.1:1502", "tcp://192.0.2.1:1502", True),
        ("tcp://192.0.2.1:1502", "tcp://0.0.0.0:1502", False),
        ("tcp://[2001:db8::1]:1502", "tcp://[::]:1502", False),
        ("tcp://meter.example:1502", "tcp://0.0.0.0:1502", False),
        ("tcp://127.0.0.1:1502", "tcp://192.0.2.1:1502", False),
    ],
)
def test_a_line_to_an_address_of_the_gateway_is_refused(line, listening, is_own) -> None:
    assert leads_back(line, listening) is is_own


def test_an_address_of_this_machine_is_found_by_binding_to_it(monkeypatch) -> None:
    bound: list[tuple[str, int]] = []
    monkeypatch.setattr(socket.socket, "bind", lambda self, address: bound.append(address))
    for host in ("192.0.2.99", "[2001:db8::99]"):
        assert leads_back(f"tcp://{host}:1502", "tcp://0.0.0.0:1502")
    assert [row[:2] for row in bound] == [("192.0.2.99", 0), ("2001:db8::99", 0)]


def test_a_serial_port_is_the_same_by_any_of_its_names(tmp_path: Path) -> None:
    port, other = tmp_path / "port", tmp_path / "other"
    port.touch()
    other.touch()
    (tmp_path / "by-id").symlink_to(port)
    own = f"rtu://{port}"
    assert leads_back(f"ascii://{tmp_path / 'by-id'}", own)
    assert not leads_back(f"rtu://{other}", own)
    assert not leads_back("tcp://127.0.0.1", own)
    with pytest.raises(ValueError, match="to: there is no serial port /dev/nowhere"):
        check_line("to", parse("rtu:///dev/nowhere"), [])
