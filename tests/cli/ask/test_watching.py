"""read --watch: on terminals and in pipes, whatever the server, the reader and the user do."""

import json
import re
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack
from datetime import datetime

import pytest

from libmodbus_py import Device, Mapping, Server
from libmodbus_py.server.serving import Running
from tests.support.cases import each_case
from tests.support.commands import Started, on_terminal, run

WATCH = ["--watch", "0.05"]


@pytest.fixture
def mapping() -> Mapping:
    return Mapping(coils=10, holding_registers=100)


@pytest.fixture
def running(mapping: Mapping) -> Iterator[Running]:
    with Server(Device(mapping)).background("tcp://127.0.0.1:0") as running:
        yield running


def stop(process: Started) -> str:
    """Press Ctrl-C, and return what was printed to the standard error."""
    process.send_signal(signal.SIGINT)
    _, err = process.communicate()
    assert process.returncode == 130
    return err


def test_a_pipe_gets_a_line_for_each_poll_at_once(running: Running, mapping: Mapping) -> None:
    with Started("read", running.urls[0], "holding", "0", "2", *WATCH) as process:
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT[\d:.]+Z  0 0\n", process.stdout.readline())
        mapping.holding_registers[1] = 7
        while not process.stdout.readline().endswith("  0 7\n"):
            pass
        assert stop(process) == ""


def test_a_server_that_goes_and_comes_back_is_shown(mapping: Mapping) -> None:
    with ExitStack() as stack:
        running = stack.enter_context(Server(Device(mapping)).background("tcp://127.0.0.1:0"))
        url = running.urls[0]
        with Started("read", url, "holding", "0", "--json", *WATCH) as watching:
            assert json.loads(watching.stdout.readline())["values"] == [0]
            stack.close()
            while "error" not in json.loads(watching.stdout.readline()):
                pass
            with Server(Device(mapping)).background(url):
                while "values" not in json.loads(watching.stdout.readline()):
                    pass
                stop(watching)


def test_a_watch_polls_at_its_interval(running: Running) -> None:
    arguments = ["read", running.urls[0], "holding", "0", "--json", "--watch", "0.15"]
    with Started(*arguments) as process:
        times = [
            datetime.fromisoformat(json.loads(process.stdout.readline())["time"]) for _ in range(4)
        ]
        assert (times[3] - times[0]).total_seconds() > 0.25
        stop(process)


def test_a_silent_unit_is_not_asked_for_the_rest() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        url = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        result = run("read", url, "holding", "0", "60000", "coils", "0", "--timeout", "0.1", "-v")
    assert (result.code, result.out) == (1, "")
    assert result.err.count(" > ") == 1
    assert "no answer" in result.err


@each_case(
    ("end", "polls"),
    [
        (["--watch", "0.01", "--count", "2"], 2),
        (["--watch", "0.5", "--for", "10ms"], 1),
        (["--for", "0.01"], 1),
    ],
)
def test_a_watch_ends_after_its_polls(running: Running, end: list[str], polls: int) -> None:
    result = run("read", running.urls[0], "hr", 0, *end)
    assert (result.code, result.err) == (0, "")
    assert result.out.count("\n") == polls


FLOODS = {
    "flood": b"\xff" * 65536,
    "trickle": b"\0",
    "nothing": b"",
    "answers nobody asked for": b"\0\x63\0\0\0\5\1\3\2\0\7" * 1000,
}


@pytest.mark.parametrize("data", FLOODS.values(), ids=FLOODS)
def test_texts_of_hostile_servers_take_one_line_in_each_poll(data: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        end = threading.Event()

        def serve() -> None:
            while not end.is_set():
                try:
                    link, _ = listening.accept()
                except OSError:
                    return
                with link:
                    link.settimeout(0.2)
                    try:
                        while not end.wait(0.02) and data:
                            link.sendall(data)
                    except OSError:
                        pass

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            url = f"tcp://127.0.0.1:{listening.getsockname()[1]}"
            arguments = ["holding", "0", "--timeout", "0.2", "--json", *WATCH]
            with Started("read", url, *arguments) as process:
                for _ in range(3):
                    assert "error" in json.loads(process.stdout.readline())
                assert stop(process) == ""
        finally:
            end.set()
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()


def test_each_unit_has_its_lines_in_the_table(mapping: Mapping) -> None:
    devices = {unit: Device(mapping) for unit in (1, 17)}
    with Server(devices).background("tcp://127.0.0.1:0") as running:
        end = ["--watch", "0.01", "--count", "3"]
        with on_terminal("read", running.urls[0], "-u", "1,17", "hr", "0", *end) as terminal:
            terminal.until(lambda text: "3 polls" in text and text.count("unit 17\r\n") >= 3)
            assert terminal.process.wait() == 0


def test_a_terminal_has_a_table_that_is_drawn_in_place(running: Running, mapping: Mapping) -> None:
    with on_terminal("read", running.urls[0], "holding", "0", "3", *WATCH) as terminal:
        terminal.until(lambda text: text.count("\x1b[4A\r\x1b[J") >= 2)
        assert "\x1b[1m" not in terminal.output
        mapping.holding_registers[1] = 7
        terminal.until(lambda text: "\x1b[1m*     1  7\x1b[0m" in text)
        terminal.until(lambda text: text.count("      1  7") >= 1)  # and then it is old
        terminal.process.send_signal(signal.SIGINT)
        assert terminal.process.wait() == 130
        assert terminal.output.rstrip().endswith("0")
        assert "Traceback" not in terminal.output


@pytest.mark.parametrize(
    ("environment", "in_place"), [({"NO_COLOR": "1"}, True), ({"TERM": "dumb"}, False)]
)
def test_plain_terminals_get_plain_lines(running: Running, mapping: Mapping, environment, in_place):
    arguments = ["read", running.urls[0], "holding", "0", *WATCH]
    with on_terminal(*arguments, environment=environment) as terminal:
        terminal.until(lambda text: text.count("\n") >= 4)
        mapping.holding_registers[0] = 7
        terminal.until(lambda text: "  7" in text)
        assert ("\x1b[2A" in terminal.output) == in_place
        assert "\x1b[1m" not in terminal.output
        assert ("*     0  7" in terminal.output) == in_place


def test_narrow_and_low_terminals_get_what_fits(running: Running) -> None:
    arguments = ["read", running.urls[0], "holding", "0", "100", *WATCH]
    with on_terminal(*arguments, columns=20) as terminal:
        terminal.until(lambda text: "... 79 more" in text)
        for line in re.sub(r"\x1b\[\d*[A-Za-z]", "", terminal.output).splitlines():
            assert len(line) < 20
        terminal.resize(40, rows=5)
        terminal.until(lambda text: "... 98 more" in text)
        terminal.resize(1, rows=1)
        length = len(terminal.output)
        terminal.until(lambda text: len(text) > length + 20)
        assert terminal.process.poll() is None


def test_failures_stand_in_place_of_values(mapping: Mapping) -> None:
    with ExitStack() as stack:
        running = stack.enter_context(Server(Device(mapping)).background("tcp://127.0.0.1:0"))
        with on_terminal("read", running.urls[0], "holding", "0", *WATCH) as terminal:
            terminal.until(lambda text: "      0  0" in text)
            stack.close()
            terminal.until(lambda text: "refused" in text and "1 failed" in text)


def test_long_reads_show_how_far_they_are() -> None:
    wide = Mapping(holding_registers=65536)
    url_options = "?request_spacing=0.02"
    with Server(Device(wide)).background("tcp://127.0.0.1:0") as running:
        url = f"{running.urls[0]}{url_options}"
        with on_terminal("read", url, "holding", "0", "9000", "--csv") as terminal:
            terminal.until(lambda text: re.search(r"\r\d+ of 72 requests\x1b\[K", text) is not None)
            terminal.until(lambda _: terminal.process.poll() is not None)
            assert terminal.process.returncode == 0
