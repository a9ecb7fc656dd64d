"""
Times, states and named bits that are typed on a page.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from libmodbus_py import Device, Point, RegisterMap, Server
from libmodbus_py.page import live_page
from tests.support.cases import each_case
from tests.tools.page.watching import Visitor

H = "holding_registers"

MAP = RegisterMap(
    [
        Point("state", H, 0, states={0: "off", 1: "on"}),
        Point("flags", H, 1, bits={0: "door", "4..7": "mode"}),
        Point("clock", H, 2, type="unix32"),
        Point("local", H, 4, type="date48", time_zone="Europe/Berlin"),
        Point("flag", H, 7, bit=3),
        Point("doors", H, 8, count=2, bits={0: "door, left", 1: "b"}),
        Point("modes", H, 10, count=2, states={0: "off, idle", 1: "on"}),
    ]
)

NOON = datetime(2026, 7, 1, 12, tzinfo=UTC)

# Name, text, value.
TYPED: list[tuple[str, str, Any]] = [
    ("state", "on", "on"),
    ("state", "1", "on"),
    ("flags", "door=1, mode=5", {"door": True, "mode": 5}),
    ("flags", '{"door": true, "mode": 5}', {"door": True, "mode": 5}),
    ("clock", "2026-07-01T12:00:00Z", NOON),
    ("clock", "2026-07-01T14:00:00+02:00", NOON),
    ("local", "2026-07-01T12:00:00Z", NOON),
    ("flag", "on", True),
    (
        "doors",
        '[{"door, left": 1, "b": 0}, {"door, left": 0, "b": 1}]',
        [{"door, left": True, "b": False}, {"door, left": False, "b": True}],
    ),
    ("modes", "on, 0", ["on", "off, idle"]),
    ("modes", '["off, idle", "on"]', ["off, idle", "on"]),
]

REFUSED = [
    ("state", "up"),
    ("flags", "dor=1"),
    ("flags", '{"door": 1'),
    ("flags", '{"door": "yes"}'),
    ("clock", "noon"),
    ("clock", "2026-07-01T12:00:00"),
    ("flag", "2"),
    ("doors", "b=1, b=1"),
    ("doors", '{"b": 1}'),
    ("doors", '[{"b": 1, "b": 0}, {}]'),
    ("doors", '[{"b": 1}]'),
    ("modes", '["on"'),
    ("modes", "[" * 1900),
]


def sent(device: Device, name: str, text: str) -> Any:
    with live_page(Server(device)) as page:
        given = {"unit": None, "point": list(MAP).index(name), "name": name, "text": text}
        return Visitor(page.url).post("/value", **given)


@each_case(("name", "text", "value"), TYPED)
def test_a_value_is_set(name: str, text: str, value: Any) -> None:
    device = Device.of_map(MAP)
    assert sent(device, name, text) == {}
    assert device[name] == value


@each_case(("name", "text"), REFUSED)
def test_a_wrong_value_is_refused_and_nothing_changes(name: str, text: str) -> None:
    device = Device.of_map(MAP)
    before = list(device.mapping.holding_registers[0:8])
    assert "value" in sent(device, name, text)
    assert list(device.mapping.holding_registers[0:8]) == before
