"""The output `influx`: the line protocol of InfluxDB, and servers that may refuse or lie."""

import asyncio
import base64
from collections.abc import AsyncIterator, Iterable
from contextlib import asynccontextmanager, closing, suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs

import pytest

from libmodbus_py import Point, RegisterMap
from libmodbus_py.fleet import DeviceConfig, Reading
from libmodbus_py.services.fleet.outputs import influx
from libmodbus_py.services.fleet.outputs.influx import Influx, LineProtocol, _shown
from libmodbus_py.services.fleet.readings import Quality
from libmodbus_py.services.other_servers import SecretFile
from tests.support import outputs
from tests.support.cases import each_case
from tests.support.golden import Refused
from tests.support.secret_files import write_secret

Answer = bytes | list[bytes] | None
"""The bytes of an answer; a list to send again and again what stands last; None to close."""


class Last(bytes):
    """An answer, behind which the connection is closed."""


def response(status: str, body: bytes = b"", *headers: str) -> bytes:
    lines = "".join(f"{header}\r\n" for header in headers)
    head = f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n{lines}\r\n"
    return head.encode() + body


NO_CONTENT = response("204 No Content")


class Received(NamedTuple):
    line: str
    headers: dict[str, str]
    body: bytes


class HttpServer:
    """A server that gives these answers, one for each request; then 204."""

    def __init__(self, answers: Iterable[Answer]) -> None:
        self.answers = [*answers]
        self.received: list[Received] = []
        self.url = ""
        self.talks: set[asyncio.Task[None] | None] = set()

    async def talk(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.talks.add(asyncio.current_task())
        with closing(writer), suppress(ConnectionError, asyncio.IncompleteReadError):
            while await self._answer(reader, writer):
                pass

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> bool:
        first, *rest = (await reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        headers = {name.lower(): value for name, value in (text.split(": ") for text in rest[:-2])}
        body = await reader.readexactly(int(headers["content-length"]))
        self.received.append(Received(first.removesuffix(" HTTP/1.1"), headers, body))
        answer = self.answers.pop(0) if self.answers else NO_CONTENT
        if answer is None:
            return False
        if isinstance(answer, bytes):
            writer.write(answer)
            return not isinstance(answer, Last)
        writer.write(b"".join(answer[:-1]))
        while True:
            writer.write(answer[-1])
            await writer.drain()
            await asyncio.sleep(0)


@asynccontextmanager
async def serving(answers: Iterable[Answer] = ()) -> AsyncIterator[HttpServer]:
    http = HttpServer(answers)
    server = await asyncio.start_server(http.talk, "127.0.0.1", 0)
    http.url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    try:
        yield http
    finally:
        server.close()
        for task in filter(None, http.talks):
            task.cancel()
        await asyncio.gather(*filter(None, http.talks), return_exceptions=True)


READING = Reading(1_700_000_000.0, "north", "level", 7, "m", "good")
LINE = b"modbus,device=north level=7 1700000000000000000\n"


def write(*answers: Answer, **keys: Any) -> HttpServer:
    """Write a reading to a server that answers so, and return the server."""

    async def go() -> HttpServer:
        async with serving(answers) as server:
            await outputs.write(Influx(url=server.url, **({"database": "plant"} | keys)), [READING])
            return server

    return asyncio.run(go())


def test_influxdb_1_gets_a_database_and_a_login() -> None:
    (received,) = write(user="me", password="secret").received
    assert received.line == "POST /write?db=plant&precision=ns"
    login = base64.b64encode(b"me:secret").decode()
    assert received.headers["authorization"] == f"Basic {login}"
    assert received.body == LINE


def test_influxdb_2_gets_a_bucket_and_a_token(tmp_path: Path) -> None:
    write_secret(tmp_path / "token", "a secret\n")
    token = SecretFile(tmp_path / "token")
    keys = {"database": None, "bucket": "a b", "organization": "plant"}
    (received,) = write(token=token, **keys).received
    path, _, query = received.line.partition("?")
    assert path == "POST /api/v2/write"
    assert parse_qs(query) == {"bucket": ["a b"], "org": ["plant"], "precision": ["ns"]}
    assert received.headers["authorization"] == "Token a secret"
    assert received.body == LINE


def test_without_credentials_no_login_is_sent() -> None:
    (received,) = write().received
    assert "authorization" not in received.headers


async def test_an_empty_write_sends_no_request() -> None:
    async with serving() as server:
        await outputs.write(Influx(url=server.url, database="plant"), [])
        assert server.received == []


@each_case(
    ("answer", "error", "message"),
    [
        (response("400 Bad", b'{"error":"partial write"}'), ValueError, "400 .*partial write"),
        (response("413 Too Large"), ValueError, "413"),
        (response("422 Unprocessable"), ValueError, "422"),
        (response("401 Unauthorized", b"who is s3cret?"), OSError, "401 who is \\*\\*\\*\\?$"),
        (response("403 Forbidden"), OSError, "403"),
        (response("404 Not Found", b"no database"), OSError, "404 no database"),
        (response("500 Broken"), OSError, "500"),
        (response("503 Busy"), OSError, "503"),
        # Servers that lie, and other programs at this port.
        (
            response("200 OK", b"<html>welcome</html>"),
            OSError,
            "answered 200 to a write, InfluxDB 204",
        ),
        (response("302 Found", b"", "Location: http://192.0.2.9/"), OSError, "302"),
        (response("400 Bad", b"\x1b[2Jred"), ValueError, r"400 \\x1b\[2Jred"),
        (response("999 What"), OSError, "999"),
        (Last(b"SSH-2.0-OpenSSH\r\n"), ConnectionError, None),
        (Last(b"HTTP/1.1 204 No Content\r\nContent-Len"), ConnectionError, None),
        (None, ConnectionError, None),
    ],
)
def test_answers_that_confirm_nothing_are_errors_of_influx(answer, error, message) -> None:
    with pytest.raises(error, match=message) as raised:
        write(answer, token="s3cret", database=None, bucket="b")
    # Only a lost connection may be due to the readings.
    assert isinstance(raised.value, ConnectionError) is (error is ConnectionError)


@each_case(
    "answer",
    [
        [b"HTTP/1.1 200 OK\r\n\r\n", b"x" * 65536],
        [b"HTTP/1.1 500 No\r\nTransfer-Encoding: chunked\r\n\r\n", b"1\r\nx\r\n"],
    ],
)
def test_an_infinite_answer_is_not_read_to_the_end(answer: Answer) -> None:
    with pytest.raises(OSError, match=r"(InfluxDB 204: is this its URL.|500 x{200})$"):
        write(answer)


@each_case("answer", [[b"HTTP/1.1 204 No", b""], [b"HTTP/1.1 204 No Content\r\n", b"X: y\r\n"]])
def test_a_missing_answer_ends_with_the_timeout(answer: Answer) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(influx, "TIMEOUT_S", 0.2)
        with pytest.raises(TimeoutError, match="did not answer"):
            write(answer)


def test_bad_keys_are_refused(refused: Refused) -> None:
    refused("refused_influx.txt", lambda keys: Influx(**keys))


def test_lines_are_appended_to_a_file(tmp_path: Path) -> None:
    for _ in range(2):
        asyncio.run(outputs.write(Influx(str(tmp_path / "lines"), measurement="plant"), [READING]))
    assert (tmp_path / "lines").read_bytes() == 2 * LINE.replace(b"modbus", b"plant")


@pytest.mark.parametrize(
    ("user", "secret", "repeated"),
    [
        *((None, "a  b", "a  b"), (None, "a  b", "a b"), (None, "a b", "a\n b")),
        *(("me", "pw", base64.b64encode(b"me:pw").decode()), ("me", "pw", "pw")),
    ],
)
def test_credentials_that_a_server_repeats_are_not_shown(user, secret, repeated) -> None:
    answer = f"unauthorized: {repeated}".encode()
    assert _shown(answer, user, secret) == "unauthorized: ***"


TIME = 1_700_000_000.25
STAMP = "1700000000250000000"

MAP = RegisterMap(
    [
        Point("level", "holding_registers", 0),
        Point("state", "holding_registers", 1, states={0: "off", 1: "on"}),
    ]
)


def read(value: Any, name: str = "level", quality: Quality = "good", reason: str = "") -> Reading:
    return Reading(TIME, "north", name, value, "m", quality, reason)


def protocol(measurement: str = "modbus", name: str = "north") -> LineProtocol:
    protocol_ = LineProtocol(measurement)
    protocol_.describe({name: DeviceConfig(name, "tcp://127.0.0.1", MAP)})
    return protocol_


def lines_of(*readings: Reading, **labels: str) -> str:
    return protocol().lines([reading._replace(labels=labels) for reading in readings]).decode()


@each_case(
    ("reading", "fields"),
    [
        (read(230.5), "level=230.5"),
        (read(7), "level=7"),
        (read(-7), "level=-7"),
        (read(1e-7), "level=1e-07"),
        (read(2**64 - 1), "level=18446744073709551615"),
        (read(True), "level=true"),
        (read(False), "level=false"),
        (read("on"), 'level="on"'),
        (read(""), 'level=""'),
        (read('5" pipe\\valve'), r'level="5\" pipe\\valve"'),
        (read("two\nlines\x1b"), r'level="two\\x0alines\\x1b"'),
        (read([1, 2.5]), "level.0=1,level.1=2.5"),
        (read([1, None]), "level.0=1"),
        (read({"door": True, "mode": 3}), "level.door=true,level.mode=3"),
        (read(datetime(2026, 1, 2, tzinfo=UTC)), 'level="2026-01-02T00:00:00+00:00"'),
        (read(5, reason="Fell"), 'level=5,level.reason="Fell"'),
        # A point without a value tells why.
        (read(None, "x", "bad", "Missing"), 'x.quality="bad",x.reason="Missing"'),
        (read(None, "x", "down", "Timeout"), 'x.quality="down",x.reason="Timeout"'),
        (read(None, "x", "offline"), 'x.quality="offline"'),
        # InfluxDB refuses a number in a field that was text before.
        (read("on", "state"), 'state="on"'),
        (read(7, "state"), 'state="7"'),
        # Names are escaped.
        (read(1, "a b"), r"a\ b=1"),
        (read(1, "a,b=c"), r"a\,b\=c=1"),
        (read(1, 'a"b'), 'a"b=1'),
        (read(1, "a\\"), "a%5C=1"),
        (read(1, "time"), "time_=1"),
        (read(1, "_field"), "_field_=1"),
        (read(1, "Füllstand"), "Füllstand=1"),
    ],
)
def test_readings_are_fields_of_one_line(reading: Reading, fields: str) -> None:
    assert lines_of(reading) == f"modbus,device=north {fields} {STAMP}\n"


def test_each_poll_is_one_line() -> None:
    later = read(3)._replace(time=TIME + 1)
    other = read(4)._replace(device="south")
    assert lines_of(read(1), read(2, "flow"), later, other).splitlines() == [
        f"modbus,device=north level=1,flow=2 {STAMP}",
        "modbus,device=north level=3 1700000001250000000",
        f"modbus,device=south level=4 {STAMP}",
    ]


def test_labels_are_sorted_tags_without_empty_ones() -> None:
    labels = {"site": "Halle 2", "line": "a,b=c\\", "area": ""}
    assert lines_of(read(1), **labels) == (
        rf"modbus,device=north,line=a\,b\=c%5C,site=Halle\ 2 level=1 {STAMP}" + "\n"
    )


def test_measurements_are_escaped() -> None:
    assert protocol("my, data").lines([read(1)]).startswith(rb"my\,\ data,device")


@each_case("measurement", ["", "_internal", "#comment", "two\nlines", "back\\slash", "x" * 201])
def test_bad_measurements_are_refused(measurement: str) -> None:
    with pytest.raises(ValueError, match="measurement"):
        LineProtocol(measurement)


def test_a_point_without_values_is_left_out() -> None:
    assert lines_of(read([])) == ""
    assert lines_of(read([]), read(1, "flow")) == f"modbus,device=north flow=1 {STAMP}\n"
