"""
Gateways, fleets, listeners, scans and live pages, while the n-th call of the system fails: whoever
asks afterwards is answered.
"""

import asyncio
import contextlib
import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from libmodbus_py import Fleet, Gateway, Point, RegisterMap, Route
from libmodbus_py.protocol import framing
from libmodbus_py.protocol.tables import TABLES
from libmodbus_py.scan import scan, search
from libmodbus_py.services.fleet.outputs.line_file import JsonOutput
from libmodbus_py.services.fleet.poller import DeviceState
from libmodbus_py.tools.listener.listener import listen
from libmodbus_py.tools.page.page import live_page
from tests.faults.injecting import Scenario, Trial, eventually, try_faults
from tests.faults.test_clients import Place, each_echoed, on_line, tcp, udp
from tests.faults.test_servers import (
    LINE_ANSWER,
    LINE_REQUEST,
    TCP_ANSWER,
    ask_while_failing,
    over,
    port_of,
    server,
)
from tests.faults.test_servers import line as line
from tests.services.fleet.fleets import meter, until
from tests.support.peers import FakeServer, FakeUnit

GATEWAY = ("services.gateway", "server", "client", "ports", "device")
SCAN = ("tools.scan", "client", "ports")

# Where a fault takes an answer away, somebody waits so long.
SHORT = 0.05


@pytest.fixture(autouse=True)
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits long for the next attempt."""
    for name in (
        *("services.tasks.FIRST_PAUSE_S", "server.peers.RETRY_AFTER"),
        "tools.listener.listener.REOPEN_AFTER",
    ):
        monkeypatch.setattr(f"libmodbus_py.{name}", 0.001)


ask = over(socket.SOCK_STREAM)


def passing(device: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        background = Gateway([Route(device)]).background("tcp://127.0.0.1:0")
        ask_while_failing(trial, background, ask, TCP_ANSWER)

    return scenario


def test_a_gateway_from_tcp_to_tcp_continues_after_errors_of_the_system() -> None:
    with FakeServer(each_echoed) as server:
        try_faults(passing(f"{server.url}?timeout=0.02&max_pause=0"), *GATEWAY)


def test_a_gateway_to_a_serial_line_continues_after_errors_of_the_system() -> None:
    with FakeUnit(on_line) as unit:
        url = f"rtu://{unit.path}?baudrate=115200&timeout=0.02&max_pause=0"
        try_faults(passing(url), *GATEWAY)


ONE = RegisterMap([Point("value", "holding_registers", 5)])

INTERVAL = 0.01


def polling(urls: list[str], file: Path) -> Scenario:
    """Poll until both were read and written, while calls fail and when they do not any more."""

    async def run(trial: Trial) -> None:
        devices = [
            meter(f"device {at}", url, map=ONE, interval=INTERVAL) for at, url in enumerate(urls)
        ]
        fleet = Fleet(devices, outputs=[JsonOutput(str(file))])
        with contextlib.ExitStack() as ends:
            ends.callback(file.unlink, missing_ok=True)
            async with contextlib.AsyncExitStack() as stack:
                with trial.faults():
                    await stack.enter_async_context(fleet)
                    await until(lambda: fleet.statistics.polls > 2 * len(urls))
                polls = fleet.statistics.polls + 2 * len(urls)
                (output,) = fleet.statistics.outputs.values()
                count = output.written
                await until(lambda: fleet.statistics.polls > polls and is_up(fleet))
                await until(lambda: output.written > count)
                with trial.faults():
                    await stack.aclose()

    return lambda trial: asyncio.run(run(trial))


def is_up(fleet: Fleet) -> bool:
    return all(device.state is DeviceState.UP for device in fleet.devices.values())


def test_a_fleet_continues_after_errors_of_the_system(tmp_path: Path) -> None:
    with FakeServer(each_echoed) as server, FakeUnit(on_line) as unit:
        urls = [
            f"{server.url}?timeout={SHORT}&max_pause=0",
            f"rtu://{unit.path}?baudrate=115200&timeout={SHORT}&max_pause=0",
        ]
        try_faults(polling(urls, tmp_path / "readings.jsonl"), "services.fleet", "client", "ports")


def hearing(url: str, between: str | None, say: Callable[[str], None]) -> Scenario:
    """Listen to one transaction while calls fail, and to another one afterwards."""

    def scenario(trial: Trial) -> None:
        with contextlib.ExitStack() as stack:
            listener = None
            with trial.faults():
                listener = stack.enter_context(listen(url, between=between))
                say(listener.url)
            if listener is not None:
                say(listener.url)
                assert next(listener).unit == 1
            with trial.faults():
                stack.close()

    return scenario


def test_a_listener_on_a_line_continues_after_errors_of_the_system(line: tuple[int, str]) -> None:
    far, path = line

    def say(url: str) -> None:
        os.write(far, LINE_REQUEST + LINE_ANSWER)

    try_faults(hearing(f"rtu://{path}?baudrate=115200", None, say), "tools.listener", "ports")


def is_passed_on(url: str) -> bool:
    with contextlib.suppress(OSError), socket.socket() as client:
        client.settimeout(SHORT)
        client.connect(port_of(url))
        client.send(LINE_REQUEST)
        return client.recv(300) == LINE_ANSWER
    return False


def test_a_tap_continues_after_errors_of_the_system() -> None:
    def say(url: str) -> None:
        assert eventually(lambda: is_passed_on(url))

    with FakeServer(on_line) as device:
        between = f"rtu+tcp://127.0.0.1:{device.port}"
        scenario = hearing("rtu+tcp://127.0.0.1:0", between, say)
        # What listens can always be shut down, and that is what ends its thread.
        try_faults(scenario, "tools.listener", "ports", without="shut down")


def got(url: str, path: str, until: bytes) -> bytes:
    """Return the bytes received for a request, up to some bytes in them."""
    where, _, token = url.partition("?")
    host, _, port = where.removeprefix("http://").strip("/").rpartition(":")
    answer = b""
    with contextlib.suppress(OSError), socket.socket() as client:
        client.settimeout(0.2)
        client.connect((host, int(port)))
        client.send(
            f"GET {path}?{token} HTTP/1.1\r\nHost: {host}:{port}\r\n"
            "Connection: close\r\n\r\n".encode()
        )
        while until not in answer and (data := client.recv(65_536)):
            answer += data
    return answer


def is_shown(url: str) -> bool:
    return b"</html>" in got(url, "/", b"</html>") and b"data:" in got(url, "/events", b"data:")


def shown() -> Scenario:
    def scenario(trial: Trial) -> None:
        view = server()
        with view.background("tcp://127.0.0.1:0"), contextlib.ExitStack() as stack:
            page = None
            with trial.faults(OSError):
                page = stack.enter_context(live_page(view))
                is_shown(page.url)
            if page is not None:
                assert eventually(lambda: is_shown(page.url))
            with trial.faults():
                stack.close()

    return scenario


def test_pages_continue_after_errors_of_the_system(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("libmodbus_py.tools.timed_server.SWEEP", 0.005)
    monkeypatch.setattr("libmodbus_py.tools.page.streams.PERIOD", 0.005)
    try_faults(shown(), "tools.page")


def unit(request: bytes) -> list[bytes]:
    """Answer reads of holding registers, and all other requests with exception 1."""
    if request[1] == 3:
        return on_line(request)
    body = bytes([request[0], request[1] | 0x80, 1])
    return [body + framing.crc16(body).to_bytes(2, "little")]


@contextlib.contextmanager
def rtu(folder: Path) -> Iterator[str]:
    with FakeUnit(unit) as peer:
        yield f"rtu://{peer.path}?baudrate=115200&parity=N"


PLACES: dict[str, Place] = {"tcp": tcp, "udp": udp, "rtu": rtu}


def finds(url: str) -> bool:
    return [unit.unit for unit in scan(url, units=[1], timeout=1)] == [1]


def scanning(url: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        with trial.faults(), scan(url, units=[1], timeout=SHORT) as units:
            for unit in units:
                assert unit.unit == 1
        assert eventually(lambda: finds(url))

    return scenario


def searching(url: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        with trial.faults(), search(url, timeout=SHORT, most_requests=8) as extents:
            assert {extent.table for extent in extents} <= set(TABLES)
        assert eventually(lambda: finds(url))

    return scenario


@pytest.mark.parametrize("kind", PLACES)
def test_a_scan_leaves_nothing_after_errors_of_the_system(tmp_path: Path, kind: str) -> None:
    with PLACES[kind](tmp_path) as url:
        try_faults(scanning(url), *SCAN)


def test_a_search_leaves_nothing_after_errors_of_the_system(tmp_path: Path) -> None:
    with udp(tmp_path) as url:
        try_faults(searching(f"{url}?unit=1"), *SCAN, errors=1)
