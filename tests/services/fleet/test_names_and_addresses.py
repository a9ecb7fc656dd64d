"""
Two names never lead to one place: topics, labels, rows of lists and connections are refused or
told apart when a file is read.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from libmodbus_py import Fleet
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.services.fleet.files import FleetFileError, load
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from tests.services.fleet.fleets import meter
from tests.support.cases import each_case

# --- topics -------------------------------------------------------------------------------------


@each_case(
    ("topic", "said"),
    [
        ("x/{device}-{name}", "must stand apart"),
        ("x/{name}.{device}/y", "must stand apart"),
        ("x/{device}/{name}/{", "a brace belongs to no name"),
        ("x}/{device}/{name}", "a brace belongs to no name"),
        ("x/{{device}/{name}", "topic"),
        ("x/{device}}/{name}", "a brace belongs to no name"),
        ("x/{device!r}/{name}", "topic must hold"),
    ],
)
def test_topics_of_two_points_differ(topic: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Mqtt("mqtt://127.0.0.1", topic=topic)


@each_case("topic", ["{device}/{name}", "x/{name}/y/{device}", "x-{device}/{name}-y"])
def test_other_topics_are_taken(topic: str) -> None:
    Mqtt("mqtt://127.0.0.1", topic=topic, status="poller")


def test_the_status_is_not_the_topic_of_a_reading() -> None:
    with pytest.raises(ValueError, match=r"status must not be the topic of a reading"):
        Mqtt("mqtt://127.0.0.1", topic="modbus/{device}/{name}", status="modbus/a/status")
    Mqtt("mqtt://127.0.0.1", topic="modbus/{device}/{name}", status="modbus/status")


# --- labels -------------------------------------------------------------------------------------


@each_case(
    ("labels", "said"),
    [
        ({"": "x"}, "does not accept the label ''"),
        ({"__x": "x"}, "does not accept the label '__x'"),
        ({"-_x": "x"}, "does not accept the label '-_x'"),
        ({"device": "x"}, "'device' is the label of every metric"),
        ({"name": "x"}, "'name' is the label of every metric"),
        ({"unit": "x"}, "'unit' is the label of every metric"),
        ({"fire-zone": "x", "fire_zone": "y"}, "'fire_zone' is the label of 'fire-zone'"),
    ],
)
def test_labels_that_prometheus_refuses_or_mixes(labels: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        meter("a", "tcp://127.0.0.1", labels=labels)


@each_case("labels", [{"fire-zone": "x"}, {"_x": "x"}, {"1": "x"}, {"größe": "x"}, {"a.b": "c"}])
def test_other_labels_are_taken(labels: dict[str, str]) -> None:
    assert meter("a", "tcp://127.0.0.1", labels=labels).labels == labels


# --- lists --------------------------------------------------------------------------------------


@pytest.fixture
def listed(tmp_path: Path) -> Callable[[str], Any]:
    """Return the names of the devices of a list in CSV."""
    (tmp_path / "fleet.toml").write_text('devices = "list.csv"')
    (tmp_path / "meter.csv").write_text("name,table,address\nx,holding_registers,0\n")

    def names(rows: str) -> list[str]:
        (tmp_path / "list.csv").write_text(f"name,url,map\n{rows}")
        return [each.name for each in load(tmp_path / "fleet.toml").devices]

    return names


def test_a_device_whose_name_begins_with_a_number_sign(listed: Callable[[str], Any]) -> None:
    with pytest.raises(FleetFileError, match=r"line 3: quote '#12' if it is a name, or put a"):
        listed("#11 is a comment\n#12,tcp://127.0.0.1,meter.csv\n")
    rows = '"#12",tcp://127.0.0.1,meter.csv\n# 12,tcp://127.0.0.1,meter.csv\n#b,tcp://b,c\n'
    assert listed(rows) == ["#12"]
    assert listed(rows.replace("\n", "\r\n")) == ["#12"]


# --- connections --------------------------------------------------------------------------------

SAME = [
    ("tcp://[::1]:502", "tcp://[0:0:0:0:0:0:0:1]"),
    ("tcp://[fe80::1%25eth0]", "tcp://[FE80:0::1%25eth0]:502"),
    ("udp://[2001:DB8::A]", "udp://[2001:db8:0:0::a]:502"),
    ("tcp://PLC.example", "tcp://plc.example:502"),
    ("rtu:///dev/../dev/ttyS0", "rtu:///dev/ttyS0"),
    ("rtu:///dev/ttyS0", "ascii:///dev/ttyS0"),
]


@each_case(("one", "other"), SAME)
def test_two_spellings_of_one_place(one: str, other: str) -> None:
    assert parse(one).key == parse(other).key
    same = [meter("a", one), meter("b", other, unit=2)]
    assert same[0].connection_key == same[1].connection_key
    if "?" not in one:
        with pytest.raises(ValueError, match="other options for the same connection"):
            Fleet([meter("a", one), meter("b", f"{other}?timeout=3", unit=2)])
