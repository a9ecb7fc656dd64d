"""Devices of a fleet: bounds that are promised, names, addresses, and the table [engine]."""

from typing import Any

import pytest

from libmodbus_py import Fleet, Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.services.fleet.config import ENGINE
from libmodbus_py.services.workers.records import FleetSettings
from tests.services.fleet.fleets import meter
from tests.support.cases import each_case
from tests.support.golden import Refused


@each_case(("key", "low", "high"), [("gap", 0, 2000), ("max_registers", 1, 125)])
def test_both_ends_of_a_range_are_valid(key: str, low: int, high: int) -> None:
    points = RegisterMap([Point("power", "holding_registers", 0)])
    for value in (low, high):
        options: dict[str, Any] = {key: value}
        device = DeviceConfig("meter", "tcp://192.0.2.1", points, **options)
        assert getattr(device, key) == value
    for value in (low - 1, high + 1):
        options = {key: value}
        with pytest.raises(ValueError, match=rf"{key} must be in {low}\.\.{high}"):
            DeviceConfig("meter", "tcp://192.0.2.1", points, **options)


def test_an_unknown_item_is_answered_with_eight_names_that_exist() -> None:
    many = RegisterMap([Point(f"p{at}", "holding_registers", at) for at in range(9)])
    listed = "it has p0, p1, p2, p3, p4, p5, p6, p7, \\.\\.\\.$"
    with pytest.raises(ValueError, match=rf"items\[0\]: the map has no point 'level' .*{listed}"):
        DeviceConfig("pump", "tcp://192.0.2.1", many, items=("level",))
    given_twice = DeviceConfig("pump", "tcp://192.0.2.1", many, items=("p1", "p0", "p1"))
    assert given_twice.items == ("p1", "p0")


def test_labels_that_prometheus_refuses_or_merges_are_invalid(refused: Refused) -> None:
    refused("wrong_labels.txt", lambda labels: meter("a", "tcp://127.0.0.1", labels=labels))


@each_case("labels", [{"fire-zone": "x"}, {"_x": "x"}, {"1": "x"}, {"größe": "x"}, {"a.b": "c"}])
def test_good_labels_are_accepted(labels: dict[str, str]) -> None:
    assert meter("a", "tcp://127.0.0.1", labels=labels).labels == labels


SAME = [
    ("tcp://[::1]:502", "tcp://[0:0:0:0:0:0:0:1]"),
    ("tcp://[fe80::1%25eth0]", "tcp://[FE80:0::1%25eth0]:502"),
    ("udp://[2001:DB8::A]", "udp://[2001:db8:0:0::a]:502"),
    ("tcp://PLC.example", "tcp://plc.example:502"),
    ("rtu:///dev/../dev/ttyS0", "rtu:///dev/ttyS0"),
    ("rtu:///dev/ttyS0", "ascii:///dev/ttyS0"),
]


@each_case(("one", "other"), SAME)
def test_two_spellings_of_a_url_share_one_connection(one: str, other: str) -> None:
    assert parse(one).key == parse(other).key
    same = [meter("a", one), meter("b", other, unit=2)]
    assert same[0].connection_key == same[1].connection_key
    if "?" not in one:
        with pytest.raises(ValueError, match="other options for the same connection"):
            Fleet([meter("a", one), meter("b", f"{other}?timeout=3", unit=2)])


def settings(keys: dict[str, Any]) -> FleetSettings:
    return FleetSettings(**ENGINE.read(("engine",), keys))


def test_settings_of_workers_have_default_values() -> None:
    assert settings({}) == FleetSettings(10.0, "stop", False, 86_400.0, 1 << 30)
    keys = {"lease": 0.5, "on_engine_loss": "continue", "commands": True}
    sizes = {"max_age": 60, "max_bytes": 65536}
    assert settings({**keys, **sizes}) == FleetSettings(0.5, "continue", True, 60.0, 1 << 16)


def test_a_wrong_setting_of_an_engine_is_named(refused: Refused) -> None:
    refused("wrong_settings.txt", settings)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"devices": 5}, r"devices must be a list of DeviceConfig, not int"),
        ({"outputs": "meter.csv"}, r"outputs must be a list of outputs, not str"),
        ({"outputs": 5}, r"outputs must be a list of outputs, not int"),
        ({"outputs": [print]}, r"outputs\[0\] must be an Output, not builtin_function_or_method"),
        ({"journal": "readings"}, r"journal must be a Journal, not str"),
        ({"may_ask": True}, r"may_ask must be a function, not bool"),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else None,
)
def test_arguments_of_a_fleet_are_checked(arguments: dict[str, Any], text: str) -> None:
    with pytest.raises(TypeError, match=f"^{text}$"):
        Fleet(**arguments)
