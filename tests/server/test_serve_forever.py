"""Programs that do nothing but serve, as processes of their own, and the signals that end them."""

import asyncio
import logging
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

import pytest

from libmodbus_py import Client, Device, Mapping, Server
from libmodbus_py.ports.endpoint import parse
from libmodbus_py.serve import Running
from libmodbus_py.server.running import signal_handlers

HEAD = """
import logging, signal, sys, threading
from libmodbus_py import Device, Mapping, Server

# A shell that runs the tests in the background has SIGINT ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
server = Server(Device(Mapping(holding_registers={7: [555]})))
"""

PLAIN = """
logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s %(message)s")
server.serve_forever("tcp://127.0.0.1:0", "udp://127.0.0.1:0")
print("returned", server.statistics.requests)
"""

QUIET = """
def say(running):
    sys.stderr.write(f"listening on {running.urls[0]}\\n")

signal.signal(signal.SIGTERM, lambda *_: print("own handler"))
server.serve_forever("tcp://127.0.0.1:0", on_listening=say)
print("returned")
print(signal.getsignal(signal.SIGINT) is signal.default_int_handler)
signal.raise_signal(signal.SIGTERM)
"""

THREAD = """
def say(running):
    sys.stderr.write(f"listening on {running.urls[0]}\\n")

def serve():
    server.serve_forever("tcp://127.0.0.1:0", on_listening=say)

threading.Thread(target=serve, daemon=True).start()
try:
    signal.pause()
except KeyboardInterrupt:
    print("interrupted")
"""


@contextmanager
def program(text: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run the program; yield the first URL in its log, too."""
    process = subprocess.Popen(
        [sys.executable, "-c", HEAD + text],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        yield process, process.stderr.readline().rstrip("\n").partition("listening on ")[2]
    finally:
        process.kill()
        process.communicate()


def end(process: subprocess.Popen[str], number: signal.Signals) -> tuple[str, str]:
    process.send_signal(number)
    return process.communicate(timeout=20)  # on a busy machine


def read(url: str) -> list[int]:
    with Client(url) as plc:
        return plc.read_holding_registers(7, 1)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_signals_end_a_server_in_order_during_requests(number: signal.Signals) -> None:
    with program(PLAIN) as (process, url), socket.socket() as half_way:
        assert process.stderr is not None
        second = process.stderr.readline()
        assert second.startswith("INFO libmodbus_py.server.serving listening on udp://127.0.0.1:")
        assert read(url) == [555]
        half_way.connect(("127.0.0.1", parse(url).port))
        half_way.sendall(b"\0\1\0\0\0\6\1")
        half_way.settimeout(20)
        assert end(process, number) == ("returned 1\n", "")
        assert half_way.recv(10) == b""
    assert process.returncode == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_serve_forever_prints_nothing_and_restores_signal_handlers(number: signal.Signals) -> None:
    with program(QUIET) as (process, url):
        assert read(url) == [555]
        assert end(process, number) == ("returned\nTrue\nown handler\n", "")
        assert process.returncode == 0


def test_another_thread_serves_without_signals() -> None:
    with program(THREAD) as (process, url):
        assert read(url) == [555]
        assert end(process, signal.SIGINT) == ("interrupted\n", "")
        assert process.returncode == 0


def test_an_exception_of_on_listening_ends_serve_forever() -> None:
    servers: list[Running] = []

    def fail(running: Running) -> None:
        servers.append(running)
        raise BrokenPipeError

    with pytest.raises(BrokenPipeError):
        Server(Device(Mapping())).serve_forever("tcp://127.0.0.1:0", on_listening=fail)
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", parse(servers[0].urls[0]).port))


def ways(server: Server, url: str) -> list[Callable[[], object]]:
    async def serving() -> None:
        async with server.serving(url):
            pass

    return [
        lambda: asyncio.run(serving()),
        lambda: server.background(url).__enter__(),
        lambda: server.serve_forever(url),
    ]


@pytest.mark.parametrize(
    ("url", "names"),
    [
        ("tcp://127.0.0.1:0?unit=1", "unit"),
        ("udp://127.0.0.1:0?timeout=1&retries=2", "timeout, retries"),
        ("rtu:///dev/null?baudrate=9600&unit=7", "unit"),
    ],
)
@pytest.mark.parametrize("way", range(3))
def test_servers_refuse_the_options_of_clients(url: str, names: str, way: int) -> None:
    with pytest.raises(ValueError, match=f": {names} is for clients"):
        ways(Server(Device(Mapping())), url)[way]()


def test_all_ways_to_serve_log_their_url(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "libmodbus_py")
    with Server(Device(Mapping())).background("tcp://127.0.0.1:0") as running:
        time.sleep(0)
    assert caplog.messages == [f"listening on {running.urls[0]}"]


def test_the_handlers_of_a_program_are_back_after_a_failure() -> None:
    def own(number: int, frame: FrameType | None) -> None: ...

    numbers = (signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, own) for number in numbers}

    async def main() -> None:
        with signal_handlers(dict.fromkeys(numbers, lambda: None)):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        asyncio.run(main())
    assert [signal.signal(number, handler) for number, handler in before.items()] == [own, own]
