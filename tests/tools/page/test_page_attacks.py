"""Attacks on the page: who may not ask, requests that are none, and visitors who never end."""

import json
import os
import socket
import threading
import time
from contextlib import ExitStack, suppress
from typing import Any

import pytest

from libmodbus_py.page import live_page
from tests.support.cases import each_case
from tests.support.commands import PAGE_TOKEN, Started, page_url, run
from tests.support.peers import until
from tests.support.programs import HeldPort
from tests.tools.page.watching import Visitor, make_server, page_of

PATHS = ["/", "/scripts/page.js", "/events", "/log.csv", "/value"]


def raw(visitor: Visitor, data: bytes, *, ends: bool = False) -> bytes:
    """Send bytes, give all that comes back."""
    received = b""
    with socket.create_connection(visitor.address, 20) as connection:
        with suppress(OSError):  # the page may have closed the connection before
            connection.sendall(data)
            if ends:
                connection.shutdown(socket.SHUT_WR)
        with suppress(ConnectionResetError):  # the page did not read all bytes
            while piece := connection.recv(65536):
                received += piece
    return received


CHANGE = {"unit": 1, "point": 1, "name": "level", "text": "9"}

STRANGERS: dict[str, dict[str, str | None]] = {
    "no token": {"Cookie": None},
    "wrong token": {"Cookie": "libmodbus_page_{port}=AAAA"},
    "token of another port": {"Cookie": "libmodbus_page_1={token}"},
    "token that is not an ASCII": {"Cookie": "libmodbus_page_{port}=\u00fc"},
    "broken cookie": {"Cookie": "libmodbus_page_{port}[]={token};;;=="},
    "foreign host": {"Host": "evil.example:{port}", "Origin": "http://evil.example:{port}"},
    "host that begins as ours": {"Host": "127.0.0.1.evil.example:{port}"},
    "another port": {"Host": "127.0.0.1:1", "Origin": "http://127.0.0.1:1"},
    "no port": {"Host": "127.0.0.1", "Origin": "http://127.0.0.1"},
    "no host": {"Host": "", "Origin": "http://"},
    "foreign origin": {"Origin": "http://evil.example"},
    "another page of this machine": {"Origin": "http://127.0.0.1:1"},
    "no origin that it says": {"Origin": "null"},
    "https": {"Origin": "https://127.0.0.1:{port}"},
}


@each_case("stranger", STRANGERS)
def test_a_request_without_the_token_is_refused(stranger: str) -> None:
    with page_of() as (server, _, visitor):
        fields = {
            name: entry and entry.format(port=visitor.address[1], token=visitor.token)
            for name, entry in STRANGERS[stranger].items()
        }
        before = server.devices[1].mapping.holding_registers[2]
        for path in PATHS:
            method = "POST" if path == "/value" else "GET"
            status, headers, data = visitor.ask(method, path, CHANGE, **fields)
            assert (status, "Set-Cookie" in headers) == (403, False), (path, data)
            assert visitor.token.encode() not in data
        assert server.devices[1].mapping.holding_registers[2] == before


def test_the_printed_address_gives_a_cookie_that_scripts_do_not_see() -> None:
    with page_of() as (_, _, visitor):
        path, own = f"/?token={visitor.token}", visitor.headers["Cookie"]
        status, headers, data = visitor.ask("GET", path, Cookie=None, Origin=None)
        assert status == 200
        assert b"<title>" in data
        assert headers["Set-Cookie"] == f"{own}; Path=/; HttpOnly; SameSite=Strict"
        for wrong in ("/?token=", "/?token=a&token=b", "/?token=" + "a" * 5000, "/?token=%FF"):
            assert visitor.ask("GET", wrong, Cookie=None, Origin=None)[0] == 403
        localhost = f"localhost:{visitor.address[1]}"
        assert visitor.ask("GET", path, Cookie=None, Origin=None, Host=localhost)[0] == 200
        # Pages on all ports of a machine share their cookies.
        for odd in (
            'prefs={"a":1}',
            "a=b c",
            '"',
            "a",
            "\u00fc=1",
            f"{own.partition('=')[0]}=wrong",
        ):
            for cookies in (f"{odd}; {own}", f"{own}; {odd}"):
                assert visitor.ask("GET", "/scripts/page.js", Cookie=cookies)[0] == 200, cookies
        # One host is needed, and an origin for a change.
        hosts = f"Host: {visitor.host}\r\nHost: evil"
        answer = raw(visitor, f"GET / HTTP/1.1\r\n{hosts}\r\nCookie: {own}\r\n\r\n".encode())
        assert answer.startswith(b"HTTP/1.0 403")
        assert visitor.ask("POST", "/value", CHANGE, Origin=None)[0] == 403


def test_the_headers_of_the_page_restrict_browsers() -> None:
    with page_of() as (_, _, visitor):
        for path in ("/", "/scripts/page.js", "/page.css", "/icon.svg", "/nothing"):
            _, headers, data = visitor.ask("GET", path)
            policy = headers["Content-Security-Policy"]
            assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
            assert "unsafe" not in policy
            assert "frame-ancestors 'none'" in policy
            assert headers["X-Content-Type-Options"] == "nosniff"
            assert headers["Referrer-Policy"] == "no-referrer"
            assert headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in headers
            if path == "/":  # nothing within, and nothing from elsewhere
                assert [entry for entry in (b"style=", b"onclick", b"://") if entry in data] == []


REQUESTS: list[tuple[str, str, Any, dict[str, str | None], int]] = [
    ("GET", "/log.csv?" + "&".join("a=1" for _ in range(20)), None, {}, 400),
    ("GET", "/../page.py", None, {}, 404),
    ("GET", "/%2e%2e/streams.py", None, {}, 404),
    ("GET", "//etc/passwd", None, {}, 404),
    ("GET", "http://evil.example/page.css", None, {}, 403),
    ("GET", "/value", None, {}, 404),
    ("POST", "/events", {}, {}, 404),
    ("PUT", "/value", {}, {}, 501),
    ("<script>", "/", None, {}, 501),
    ("POST", "/value", b"{", {}, 400),
    ("POST", "/value", b"[]", {}, 400),
    ("POST", "/value", b"\xff\xfe", {}, 400),
    ("POST", "/value", b"[" * 60_000, {}, 400),
    ("POST", "/value", b"1" * 5000, {}, 400),
    ("POST", "/value", {}, {"Content-Type": "text/plain"}, 415),
    ("POST", "/value", {}, {"Content-Type": "application/x-www-form-urlencoded"}, 415),
    ("POST", "/value", None, {}, 411),
    ("POST", "/value", b"", {"Content-Length": "-1"}, 411),
    ("POST", "/value", b"", {"Content-Length": "65537"}, 413),
    ("POST", "/value", b"", {"Content-Length": "9" * 30}, 413),
    ("POST", "/value", b"", {"Content-Length": "0", "Transfer-Encoding": "chunked"}, 411),
    ("POST", "/view", {"stream": [], "unit": 1, "what": {}, "first": 0, "stop": 1}, {}, 400),
]

BYTES = [
    b"\r\n\r\n",
    b"\0" * 1000,
    b"GET\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03" + bytes(500),  # TLS
    b"GET / HTTP/1.1\r\nHost: x\r\n" + b"A: b\r\n" * 50_000,
    b"GET / HTTP/1.1\r\nA: " + b"x" * 300_000,
    b"GET /" + b"x" * 300_000,
    b"GET http://[/ HTTP/1.1\r\n\r\n",
]


def test_invalid_requests_to_a_page_are_refused() -> None:
    with page_of() as (_, _, visitor):
        for method, path, body, headers, status in REQUESTS:
            assert visitor.ask(method, path, body, **headers)[0] == status, (path, body, headers)
        for data in BYTES:
            answer = raw(visitor, data, ends=True)
            assert b" 200 " not in answer[:20]
            assert b"Traceback" not in answer
        assert visitor.ask("GET", "/")[0] == 200


def test_a_connection_without_a_request_does_not_delay_others(monkeypatch: pytest.MonkeyPatch):
    """More of them than connections; who trickles has gone in time, too."""
    with page_of() as (_, _, visitor), ExitStack() as stack:
        before = threading.active_count()
        for _ in range(100):
            loris = stack.enter_context(socket.create_connection(visitor.address, 20))
            loris.sendall(b"GET / HTTP/1.1\r\nA:")
        assert visitor.ask("GET", "/")[0] == 200
        until(lambda: threading.active_count() - before <= 70)
    until(lambda: threading.active_count() <= before)
    monkeypatch.setattr("libmodbus_py.tools.page.page.LIMIT", 0.5)
    with page_of() as (_, _, visitor), socket.create_connection(visitor.address, 20) as loris:
        until(lambda: _is_gone(loris))


def _is_gone(loris: socket.socket) -> bool:
    try:
        return bool(time.sleep(0.05) or loris.sendall(b"A"))
    except OSError:
        return True


def test_the_number_of_open_pages_is_limited() -> None:
    with page_of() as (_, _, visitor), ExitStack() as stack:
        for _ in range(16):
            stack.enter_context(Visitor(f"http://{visitor.host}/?token={visitor.token}").watching())
        status, _, data = visitor.ask("GET", "/events")
        assert status == 503
        assert json.loads(data)["error"] == "16 pages are open, which is the maximum"
        assert visitor.ask("GET", "/")[0] == 200


def test_a_hundred_closed_pages_leave_nothing() -> None:
    threads = threading.active_count()
    with page_of() as (_, _, visitor):
        url, before = f"http://{visitor.host}/?token={visitor.token}", 0
        for number in range(100):
            until(lambda: _visited(url))
            if number in (0, 99):
                until(lambda: not any("process_req" in item.name for item in threading.enumerate()))
                before = before or len(os.listdir("/proc/self/fd"))
        until(lambda: len(os.listdir("/proc/self/fd")) <= before)
    until(lambda: threading.active_count() == threads)


def _visited(url: str) -> bool:
    """Return True if there was room; a client that has just left is noticed soon."""
    try:
        with Visitor(url).watching():
            return True
    except AssertionError:
        return False


def test_a_slow_page_gets_all_tables_when_it_reads_again() -> None:
    with page_of() as (server, _, visitor), socket.socket() as slow:
        slow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        slow.settimeout(20)
        slow.connect(visitor.address)
        head = f"GET /events HTTP/1.1\r\nHost: {visitor.host}\r\nCookie: "
        slow.sendall(f"{head}{visitor.headers['Cookie']}\r\n\r\n".encode())
        with visitor.watching():  # somebody else, who reads
            visitor.look(1, "holding_registers", 0, 20)
            registers = server.devices[1].mapping.holding_registers
            for number in range(1, 20):
                registers[10] = number
                visitor.receive(
                    lambda number=number: visitor.cells("1/holding_registers").get(10) == number
                )
        received = b""
        while b"\n\n" not in received:
            received += slow.recv(65536)


def test_a_signal_ends_a_server_with_open_streams() -> None:
    """SIGTERM with open streams, from the command line."""
    arguments = ("serve", "tcp://127.0.0.1:0", "--page", "127.0.0.1:0")
    with Started(*arguments, environment=PAGE_TOKEN) as program:
        assert program.stdout.readline().startswith("listening on tcp://127.0.0.1:")
        url = page_url(program.stdout.readline())
        visitor = Visitor(url)
        with ExitStack() as stack:
            for _ in range(5):
                stack.enter_context(Visitor(url).watching())
            stack.enter_context(socket.create_connection(visitor.address))
            program.terminate()
            assert program.wait() == 0


def test_a_page_with_an_invalid_request_gets_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        place = f"127.0.0.1:{listener.getsockname()[1]}"
        result = run("serve", "tcp://127.0.0.1:0", "--page", place, environment=PAGE_TOKEN)
    assert (result.code, result.out) == (1, "")
    assert f"cannot show a page on {place}: Address already" in result.err
    assert result.err.count("\n") == 1


OUTER_URLS = {
    "http://localhost:9000": "http://localhost:9000",  # ssh -L 9000:..., a container's port
    "https://plant.example:443/modbus/": "https://plant.example",
    "https://Plant.example": "https://plant.example",
}


@each_case("url", OUTER_URLS)
def test_changes_are_accepted_from_the_outer_url(url: str) -> None:
    origin = OUTER_URLS[url]
    with (
        HeldPort() as port,
        live_page(make_server(), port=port.number, url=url) as page,
        live_page(make_server()) as other,
    ):
        assert page.url.startswith(url.lower().replace(":443", "").rstrip("/") + "/?token=")
        visitor, stranger = Visitor(page.url), Visitor(other.url)
        assert stranger.ask("POST", "/value", CHANGE, Origin=origin)[0] == 403
        visitor.address = "127.0.0.1", port.number
        visitor.headers["Cookie"] = f"libmodbus_page_{visitor.address[1]}={visitor.token}"
        outer = origin.partition("//")[2]
        for host in (outer, f"127.0.0.1:{visitor.address[1]}"):
            assert visitor.ask("POST", "/value", CHANGE, Host=host, Origin=origin)[0] == 200
        for wrong in ("http://evil.example", origin + ":1", "null"):
            assert visitor.ask("POST", "/value", CHANGE, Host=outer, Origin=wrong)[0] == 403


@each_case(
    "url", ["", "plant.example", "ftp://h", "https://", "http://u:p@h", "http://h?a", "http://h:x"]
)
def test_a_wrong_outer_url_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="as https://HOST"), live_page(make_server(), url=url):
        pass
