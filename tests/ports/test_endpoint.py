"""URLs: what they stand for, what is wrong with them, and how they are shown."""

import os
from contextlib import closing
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from libmodbus_py import AsyncClient, Client, Device, Mapping, Point, RegisterMap, Server
from libmodbus_py.fleet import DeviceConfig
from libmodbus_py.ports.endpoint import Endpoint, parse
from libmodbus_py.ports.options import CLIENT_OPTIONS, SERIAL_OPTIONS
from libmodbus_py.ports.schemes import SCHEMES, SECURITY_OPTIONS, TRANSPORTS, options_of
from libmodbus_py.ports.serial import SerialPort
from libmodbus_py.scan import scan
from libmodbus_py.services.gateway.routes import Route
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.urls import url_for


@each_case(
    ("url", "endpoint"),
    [
        ("tcp://192.0.2.10", Endpoint("tcp", "192.0.2.10", 502)),
        ("udp://[::1]:0/", Endpoint("udp", "::1", 0)),
        ("rtu+tcp://plant.example:65535", Endpoint("rtu+tcp", "plant.example", 65535)),
        ("tls://192.0.2.10", Endpoint("tls", "192.0.2.10", 802)),
        (
            "tls://[::1]:1802?cert=a%20b.pem&key=k&ca=c&pin=1,2&server_name=n&password_env=P&unit=7",
            Endpoint(
                "tls",
                "::1",
                1802,
                options={
                    "cert": "a b.pem",
                    "key": "k",
                    "ca": "c",
                    "pin": "1,2",
                    "server_name": "n",
                    "password_env": "P",
                },
                client_options={"unit": 7},
            ),
        ),
        (
            "tcp://h?unit=7&timeout=0.5&retries=2",
            Endpoint("tcp", "h", 502, client_options={"unit": 7, "timeout": 0.5, "retries": 2}),
        ),
        (
            "rtu:///dev/ttyUSB0?baudrate=9600&parity=N&unit=7",
            Endpoint(
                "rtu",
                path="/dev/ttyUSB0",
                options={"baudrate": 9600, "parity": "N"},
                client_options={"unit": 7},
            ),
        ),
    ],
)
def test_a_url_is_parsed_into_an_endpoint(url: str, endpoint: Endpoint) -> None:
    assert parse(url) == endpoint


CLIENT_QUERIES: list[tuple[str, Any]] = [
    ("unit=255", 255),
    ("timeout=.5", 0.5),
    ("retries=3", 3),
    ("busy_retries=1", 1),
    ("max_in_flight=4", 4),
    ("turnaround=0.1", 0.1),
    ("request_spacing=0.01", 0.01),
    ("connect_delay=2", 2.0),
    ("timeouts_before_reconnect=5", 5),
    ("keepalive=30", 30.0),
    ("keepalive=none", None),
    ("max_pause=1.5", 1.5),
    ("source=192.0.2.5:40000", "192.0.2.5:40000"),
    ("greeting=20%20bytes,0x0d0a", "20 bytes,0x0d0a"),
    ("accept_unit=any", "any"),
    ("write_function=single", "single"),
    ("broadcast=0", False),
    ("ids=ignore", "ignore"),
    ("idle_close=5", 5.0),
    ("idle_close=none", None),
    ("delimiter=10", 10),
    ("delimiter=0x0D", 13),
]


@each_case("scheme", SCHEMES)
@each_case(("query", "value"), CLIENT_QUERIES)
def test_every_scheme_takes_the_options_of_clients(scheme: str, query: str, value: Any) -> None:
    url = url_for(scheme, "h:1")
    endpoint = parse(f"{url}?{query}")
    name = query.partition("=")[0]
    assert endpoint.client_options == {name: value}
    assert type(endpoint.client_options[name]) is type(value)
    assert endpoint.options == {}
    assert str(endpoint) == url
    assert parse(endpoint.url) == endpoint


def test_the_table_above_has_all_options_of_clients() -> None:
    assert {query.partition("=")[0] for query, _ in CLIENT_QUERIES} == set(CLIENT_OPTIONS)


def test_serial_settings_are_shown() -> None:
    url = "rtu:///dev/ttyS0?baudrate=9600&rs485=rts-up&rts_delay=0.001&echo=True&silence=0.01"
    endpoint = parse(f"{url}&timeout=2.0")
    assert str(endpoint) == url
    assert endpoint.url == f"{url}&timeout=2.0"


@pytest.mark.parametrize("scheme", ["rtu+tcp", "ascii+tcp"])
@pytest.mark.parametrize(("text", "echo"), [("1", True), ("0", False)])
def test_a_line_behind_a_converter_has_the_option_echo(scheme: str, text: str, echo: bool) -> None:
    endpoint = parse(f"{scheme}://h:4001?echo={text}&unit=7")
    assert endpoint.options == {"echo": echo}
    assert endpoint.client_options == {"unit": 7}
    assert str(endpoint) == f"{scheme}://h:4001?echo={echo}"
    assert parse(endpoint.url) == endpoint


@pytest.mark.parametrize("scheme", ["tcp", "udp", "rtu+udp", "tls"])
def test_other_endpoints_refuse_the_option_echo(scheme: str) -> None:
    with pytest.raises(ValueError, match="'echo' must be one of"):
        parse(f"{scheme}://h:4001?echo=1")


ASCII = {"data_bits": 7, "silence": 0.0}


@each_case(
    ("url", "settings"),
    [
        ("ascii:///dev/ttyS0", ASCII),
        ("ascii:///dev/ttyS0?data_bits=8", {**ASCII, "data_bits": 8}),
        ("ascii:///dev/ttyS0?silence=0.1&stop_bits=2", {**ASCII, "silence": 0.1, "stop_bits": 2}),
        ("rtu:///dev/ttyS0?baudrate=9600", {"baudrate": 9600}),
        ("rtu:///dev/ttyS0?unit=1", {}),
    ],
)
def test_ascii_has_seven_data_bits_and_no_silence(url: str, settings: dict[str, Any]) -> None:
    assert parse(url).serial_settings == settings


ALL = ", ".join([*SERIAL_OPTIONS, *CLIENT_OPTIONS])


def test_wrong_urls_are_refused_with_what_is_allowed(refused: Refused) -> None:
    """Also schemes of other programs, such as pyserial, simonvetter/modbus, Telegraf and W3C."""
    refused("wrong_urls.txt", parse)


def test_a_misspelt_scheme_is_answered_with_similar_ones() -> None:
    with pytest.raises(ValueError, match="; did you mean tcp"):
        parse("tpc://192.0.2.10")


def test_rfc_2217_is_refused_with_the_remedy() -> None:
    text = "RFC 2217 is not supported; set the line in the serial device server.*use rtu\\+tcp://"
    with pytest.raises(ValueError, match=text):
        parse("rfc2217://192.0.2.10:4001")


@each_case(("text", "parity"), [("none", "N"), ("Even", "E"), ("odd", "O"), ("e", "E")])
def test_parity_is_a_letter_or_a_word(text: str, parity: str) -> None:
    assert parse(f"rtu:///dev/ttyS0?parity={text}").options == {"parity": parity}


def test_files_are_not_part_of_the_text_of_an_endpoint() -> None:
    endpoint = parse("tls://h?cert=a%20b.pem&ca=c&unit=7")
    assert str(endpoint) == "tls://h:802"
    assert endpoint.url == "tls://h:802?cert=a%20b.pem&ca=c&unit=7"


@pytest.mark.parametrize(
    "url", ["tls://h?cert=x&password=secret", "tls://me:secret@h", "tcp://h?key_password=secret&x"]
)
def test_no_error_shows_a_password(url: str) -> None:
    with pytest.raises(ValueError, match=r"'t.*\*\*\*.*h?.*: ") as caught:
        parse(url)
    assert "secret" not in str(caught.value)


ODD = ["#x", "?a=1", "%23", "a b", "ä", "\udcff", "a:b@c", "+", "//x", "a&b=c", "\n", "'\"[]"]


@each_case("path", [f"/dev/tty{odd}" for odd in ODD])
def test_a_path_is_the_same_after_url_and_parsing(path: str) -> None:
    endpoint = Endpoint("rtu", path=path, options={"baudrate": 9600}, client_options={"unit": 3})
    assert parse(endpoint.url) == endpoint
    assert parse(str(endpoint)).path == path
    assert endpoint.url.isascii()
    assert hash(parse(endpoint.url)) == hash(endpoint)


# Names of files are bytes, most of which are UTF-8.
NAMES = st.text(st.characters(codec="utf-8"), min_size=1) | st.binary(min_size=1).map(os.fsdecode)
HOSTS = st.from_regex(r"[a-z0-9.-]{1,20}", fullmatch=True) | st.ip_addresses().map(str)
ZONED = st.ip_addresses(v=6).map("{}%enP8p1s0".format)
NUMBERS, SECONDS = st.integers(0, 10**9), st.floats(0, 1e300)
VALUES: dict[str, st.SearchStrategy[Any]] = {
    **dict.fromkeys(SECURITY_OPTIONS, NAMES),
    **dict.fromkeys(("rs485", "accept_unit", "source", "greeting"), NAMES),
    **dict.fromkeys(("write_function", "ids"), NAMES),
    **dict.fromkeys(("echo", "broadcast"), st.booleans()),
    **dict.fromkeys(("rts_delay", "silence", "timeout", "turnaround"), SECONDS),
    **dict.fromkeys(("request_spacing", "connect_delay", "max_pause"), SECONDS),
    **dict.fromkeys(("keepalive", "idle_close"), st.none() | SECONDS),
    "parity": st.sampled_from("NEO"),
}


@st.composite
def endpoints(draw: st.DrawFn) -> Endpoint:
    scheme = draw(st.sampled_from(list(SCHEMES)))
    own, others = (
        {name: draw(VALUES.get(name, NUMBERS)) for name in draw(st.sets(st.sampled_from(names)))}
        if (names := list(options))
        else {}
        for options in (options_of(scheme), CLIENT_OPTIONS)
    )
    if TRANSPORTS[SCHEMES[scheme][1]].has_path:
        return Endpoint(scheme, "", 0, f"/x{draw(NAMES)}", own, others)
    return Endpoint(scheme, draw(HOSTS | ZONED), draw(st.integers(0, 65535)), "", own, others)


@given(endpoints())
def test_every_endpoint_is_the_same_after_url_and_parsing(endpoint: Endpoint) -> None:
    again = parse(endpoint.url)
    assert again == endpoint
    assert (hash(again), again.key) == (hash(endpoint), endpoint.key)
    visible = parse(str(endpoint))
    assert visible == replace(again, client_options={}, options=visible.options)
    assert visible.options == ({} if endpoint.is_secure else endpoint.options)


def test_the_zone_of_an_address_is_the_name_of_an_interface_as_it_is_written() -> None:
    for text in (
        "FE80::A%enP8p1s0",
        "[FE80::A%enP8p1s0]:502",
        "tcp://[FE80::A%enP8p1s0]",
        "tcp://[FE80::A%25enP8p1s0]",  # RFC 6874
    ):
        assert parse(text).host == "fe80::a%enP8p1s0"
        assert str(parse(text)) == "tcp://[fe80::a%25enP8p1s0]:502"
    for text in ("fe80::1%25", "tcp://[fe80::1%25]", "tcp://[fe80::1%2525]"):
        assert parse(text).host == "fe80::1%25"  # the 25th interface
    assert parse("tcp://[fe80::1%lo]").key != parse("tcp://[fe80::1%LO]").key


def test_a_path_without_a_scheme_is_a_serial_port() -> None:
    assert parse("/dev/tty#x").path == "/dev/tty#x"
    assert parse("/dev/tty%23x?unit=7").path == "/dev/tty%23x"


def test_a_url_is_text() -> None:
    with pytest.raises(TypeError, match="url must be a string, not int"):
        parse(502)  # type: ignore[arg-type]


SAME = [
    ("tcp://Plant.example", "rtu+tcp://plant.example:502?timeout=2"),
    ("tcp://192.0.2.10:802", "tls://192.0.2.10"),
    ("udp://192.0.2.10", "rtu+udp://192.0.2.10:502"),
    ("rtu:///dev/ttyS0?baudrate=9600", "ascii:///dev/../dev//ttyS0"),
    ("unix:///run/modbus.sock", "unix:////run/modbus.sock"),
]

DIFFERENT = [
    ("tcp://192.0.2.10", "udp://192.0.2.10"),
    ("tcp://192.0.2.10", "tcp://192.0.2.10:503"),
    ("tcp://192.0.2.10", "tcp://192.0.2.11"),
    ("rtu:///dev/ttyS0", "rtu:///dev/ttyS1"),
]


@each_case(("one", "other"), SAME)
def test_endpoints_at_one_address(one: str, other: str) -> None:
    assert parse(one).key == parse(other).key


@each_case(("one", "other"), DIFFERENT)
def test_endpoints_at_two_addresses(one: str, other: str) -> None:
    assert parse(one).key != parse(other).key


def test_an_ipv4_address_in_ipv6_has_the_same_key_with_every_python() -> None:
    """The module ipaddress writes it with hexadecimal digits before Python 3.13."""
    key = ("tcp", "[::ffff:192.0.2.1]:502")
    assert parse("tcp://[::ffff:c000:201]").key == parse("tcp://[::FFFF:192.0.2.1]").key == key


@each_case(
    ("text", "url"),
    [
        ("192.0.2.10", "tcp://192.0.2.10:502"),
        ("192.0.2.10:1502", "tcp://192.0.2.10:1502"),
        ("plc.example", "tcp://plc.example:502"),
        ("[::1]:1502", "tcp://[::1]:1502"),
        ("[::1]", "tcp://[::1]:502"),
        ("::1", "tcp://[::1]:502"),
        ("plc?unit=7", "tcp://plc:502"),
        ("/dev/ttyUSB0", "rtu:///dev/ttyUSB0"),
        ("/dev/ttyUSB0?parity=none", "rtu:///dev/ttyUSB0?parity=N"),
        ("/dev/serial/by-id/usb-x", "rtu:///dev/serial/by-id/usb-x"),
    ],
)
def test_typed_texts_are_parsed_into_endpoints(text: str, url: str) -> None:
    assert str(parse(text)) == url
    assert str(parse(url)) == url


def test_classes_and_functions_take_a_host_without_a_scheme() -> None:
    points = RegisterMap([Point("a", "coils", 0)])
    assert AsyncClient("192.0.2.10:1502").url == "tcp://192.0.2.10:1502"
    with closing(Client("192.0.2.10:1502")) as client:
        assert client.url == "tcp://192.0.2.10:1502"
    assert Route("192.0.2.10").endpoint.host == "192.0.2.10"
    assert DeviceConfig("a", "192.0.2.10:1502", points).endpoint.port == 1502
    with Server(Device(Mapping(coils=8))).background("127.0.0.1:0") as running:
        assert running.urls[0].startswith("tcp://127.0.0.1:")


@each_case("word", ["N", "n", "none", "None", "NONE"])
def test_parities_are_words_or_letters(word: Any) -> None:
    port = SerialPort("/dev/ttyUSB0", parity=word)
    assert port.parity == "N"
    assert port.character == SerialPort("/dev/ttyUSB0", parity="N").character
    context = Client("rtu:///dev/ttyUSB0", parity=word)
    assert context.url == Client("rtu:///dev/ttyUSB0", parity="N").url
    assert scan("/dev/ttyUSB0", parities=[word, "N"], units=[1], baudrates=[9600]).total == 1
    assert Client(f"rtu:///dev/ttyUSB0?parity={word}").url == "rtu:///dev/ttyUSB0?parity=N"


@each_case("word", ["mark", "", 5, None])
def test_other_parities_are_refused(word: Any) -> None:
    for make in (SerialPort, Client):
        with pytest.raises(ValueError, match='parity must be "N", "E" or "O"'):
            make("/dev/ttyUSB0", parity=word)


def test_a_password_is_not_printed() -> None:
    with pytest.raises(ValueError, match=r"must be a URL") as caught:
        parse("me:secret@h")
    assert "secret" not in str(caught.value)
