"""
URLs of brokers, databases and NATS servers: one rule for all that take one.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py.services.engine.connection import parse_servers
from libmodbus_py.services.fleet.outputs.exclusive import shared
from libmodbus_py.services.fleet.outputs.influx import Influx
from libmodbus_py.services.fleet.outputs.mqtt import Mqtt
from libmodbus_py.services.server_url import ServerUrl, server_url
from tests.support.cases import each_case

PORTS = {"mqtt": 1883, "mqtts": 8883}


def influx(url: str) -> Influx:
    return Influx(url=url, database="d")


TAKEN: list[tuple[str, Callable[[str], Any]]] = [
    ("mqtt", Mqtt),
    ("http", influx),
    ("nats", parse_servers),
]
"""A scheme, and what takes a URL with it."""


@each_case(
    ("text", "expected"),
    [
        ("mqtt://192.0.2.1", ServerUrl("mqtt", "192.0.2.1", 1883, False)),
        ("MQTTS://Broker.Example/", ServerUrl("mqtts", "broker.example", 8883, False)),
        ("mqtt://[2001:DB8::1]:7", ServerUrl("mqtt", "2001:db8::1", 7, False)),
        ("mqtt://me:secret@h", ServerUrl("mqtt", "h", 1883, True)),
        ("mqtt://h:0", ServerUrl("mqtt", "h", 0, False)),
        ("mqtt://h:65536", ServerUrl("mqtt", "h", 0, False)),
        ("mqtt://h:x", ServerUrl("mqtt", "h", 0, False)),
        ("http://h", None),
        ("mqtt://", None),
        ("mqtt:h", None),
        ("mqtt://h/path", None),
        ("mqtt://h?client_id=x", None),
        ("mqtt://h#x", None),
        ("mqtt://a b", None),
        ("mqtt://h\n", None),
        ("mqtt://bücher.example", None),
        ("mqtt://[::1", None),
    ],
)
def test_a_url_is_read(text: str, expected: ServerUrl | None) -> None:
    assert server_url(text, PORTS) == expected


def test_a_path_is_taken_where_it_may_be() -> None:
    found = server_url("mqtt://h/path", PORTS, may_have_path=True)
    assert found == ServerUrl("mqtt", "h", 1883, False)


def test_the_place_of_an_ipv6_address_has_brackets() -> None:
    assert ServerUrl("mqtt", "::1", 1883, False).place == "[::1]:1883"
    assert ServerUrl("mqtt", "h", 1883, False).place == "h:1883"


@each_case(("scheme", "take"), TAKEN)
@each_case("rest", ["h:0", "h:99999", "h?x=1", "h#x", "a b", "[::1", "h:x"])
def test_a_wrong_url_is_refused_before_anything_is_sent(
    scheme: str, take: Callable[[str], Any], rest: str
) -> None:
    with pytest.raises(ValueError, match=r"must be|port"):
        take(f"{scheme}://{rest}")


@each_case("make", [Mqtt, influx])
@each_case(("one", "other"), [("h.example", "H.Example"), ("[2001:db8::a]", "[2001:DB8::A]")])
def test_two_spellings_of_a_host_are_one_server(
    make: Callable[[str], Any], one: str, other: str
) -> None:
    scheme = {Mqtt: "mqtt", influx: "http"}[make]
    assert shared([make(f"{scheme}://{one}"), make(f"{scheme}://{other}")]) is not None


@each_case(
    "text",
    [
        *("http://me:secret@h:0x", "http:/me:secret@h", "x://me:p@secret@h"),
        *("http://me:secret@h:x", "x://me:secret://p@h", "me:secret@h"),
    ],
)
def test_a_wrong_url_is_not_shown_with_its_login(text: str) -> None:
    with pytest.raises(ValueError, match="must") as caught:
        influx(text)
    assert "secret" not in str(caught.value)
