"""
How many requests are sent; and devices that refuse a part of what a command asks, close the
connection, or say nothing: the command shows the rest, and why the part is missing. What is shown
of a map beside a refused point is in the session `refused`.
"""

import contextlib
import io
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from libmodbus_py import (
    Client,
    ExceptionResponse,
    Fault,
    IllegalFunction,
    ModbusConnectionError,
    ModbusError,
    ModbusTimeoutError,
)
from libmodbus_py.cli.ask.units import print_report
from libmodbus_py.cli.main import CommandError
from libmodbus_py.tools.testing.recording import ServerMaker
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.peers import FakeServer, mbap


@pytest.fixture
def maker() -> Iterator[ServerMaker]:
    with ServerMaker() as servers:
        yield servers


def test_ranges_take_as_many_requests_as_they_must(url: str) -> None:
    result = run("read", url, "holding", "0", "600", "coils", "0", "100", "-v")
    assert result.out.count("\n") == 700
    requests = [line for line in result.err.splitlines() if " > " in line]
    assert len(requests) == 6  # 600 registers of 125, and 100 coils of 2000
    assert "holding 500    500\n" in result.out
    result = run("read", url, "holding", "0", "100", "--max-registers", "30", "-v")
    assert result.err.count(" > ") == 4
    assert run("read", url, "holding", "0", "--max-registers", "0").code == 2
    # No request divides a value: four registers each, of the seven that are allowed.
    words = ("read", url, "holding", "0", "3", "--type", "float64", "--max-registers", "7", "-v")
    assert [line[-11:] for line in run(*words).err.splitlines() if " > " in line] == [
        "00 00 00 04",
        "00 04 00 04",
        "00 08 00 04",
    ]
    result = run("read", url, "file:4", "0", "200", "--type", "uint32", "--json", "-v")
    assert json.loads(result.out)["values"] == [0x70008, 0x90000, *[0] * 198]
    lengths = [int(line[-5:].replace(" ", ""), 16) for line in result.err.splitlines()[::2]]
    assert lengths == [120, 120, 120, 40]


def test_the_longest_lists_of_values_are_written_and_read(url: str) -> None:
    values = [str(number) for number in range(61)]
    assert run("write", url, "holding", "300", *values, "--type", "float32").code == 0
    result = run("read", url, "holding", "300", "62", "--type", "float32", "--json")
    assert json.loads(result.out)["values"] == [*range(61), 0]
    assert run("write", url, "file:4", "0", *values, "--type", "int32").code == 0
    result = run("read", url, "file:4", "2", "60", "--type", "int32", "--json")
    assert json.loads(result.out)["values"] == [*range(1, 61)]
    result = run("read", url, "holding", "40", "1", "--type", "string:250", "--json")
    assert json.loads(result.out)["values"] == [""]


@each_case("code", [6, 10, 11])
def test_a_busy_device_or_a_broken_path_splits_no_request(maker: ServerMaker, tmp_path, code):
    (tmp_path / "two.csv").write_text("name,table,address\na,holding,0\nb,holding,1\n")
    server = maker(faults={None: [Fault("exception", code=code)]})
    assert run("read", server.url, "--map", tmp_path / "two.csv", "--retries", "0").code == 1
    assert len(server.transactions) == 1


def test_diagnose_says_that_a_device_refused_to_listen_only(maker: ServerMaker) -> None:
    server = maker(faults={None: [Fault("exception", code=1)]})
    result = run("diagnose", server.url, "force-listen-only")
    assert result.code == 1
    assert "illegal function" in result.err


def test_diagnose_takes_silence_for_consent_to_listen_only(maker: ServerMaker) -> None:
    server = maker(faults={None: [Fault("no_answer")]})
    result = run("diagnose", server.url, "force-listen-only", "7", "--json", "--timeout", "0.1")
    assert (result.code, result.out) == (0, '{"unit": 1, "force listen only": 7}\n')
    assert len(server.transactions) == 1


Question = Callable[[Client], list[tuple[str, Any]]]


def question(answer: ModbusError | list[tuple[str, Any]]) -> Question:
    def ask(context: Client) -> list[tuple[str, Any]]:
        if isinstance(answer, ModbusError):
            raise answer
        return answer

    return ask


def report(questions: dict[str, Question], *, as_json: bool = False) -> str:
    out = io.StringIO()
    with (
        ServerMaker() as maker,
        Client(maker().url, unit=7) as context,
        contextlib.redirect_stdout(out),
    ):
        print_report(context, questions, as_json=as_json)
    return out.getvalue()


SILENCE = ModbusTimeoutError("no answer within 1 s")
CLOSED = ModbusConnectionError("the device closed the connection")
NO = IllegalFunction()


@each_case("error", [SILENCE, CLOSED, NO, ExceptionResponse(code=200)])
@each_case("at", [0, 1, 2])
def test_a_failed_request_hides_no_other_answer(error: ModbusError, at: int) -> None:
    answers: list[Any] = [[("one", 1)], [("two", 2)]]
    answers.insert(at, error)
    questions = {str(number): question(answer) for number, answer in enumerate(answers)}
    assert json.loads(report(questions, as_json=True)) == {
        "unit": 7,
        "one": 1,
        "two": 2,
        "lacking": {str(at): str(error.args[0])},
    }
    assert f"({error.args[0]})" in report(questions)


@each_case("error", [SILENCE, CLOSED])
def test_a_silent_device_is_not_asked_for_the_rest(error: ModbusError) -> None:
    requests: list[str] = []

    def silent(name: str) -> Question:
        def ask(context: Client) -> list[tuple[str, Any]]:
            requests.append(name)
            raise error

        return ask

    questions = {str(number): silent(str(number)) for number in range(12)}
    with pytest.raises(type(error)):
        report(questions)
    assert requests == ["0", "1", "2", "3"]


def test_only_refusals_in_a_report_are_an_error() -> None:
    questions = {"one": question(NO), "two": question(SILENCE)}
    with pytest.raises(CommandError, match=r"has none of these: illegal function .*; no answer"):
        report(questions)


def test_a_device_may_close_the_connection_for_what_it_does_not_know(maker: ServerMaker) -> None:
    server = maker(faults={None: [Fault("disconnect", function=43)]})
    result = run("identify", server.url)
    assert (result.code, result.err) == (0, "")
    assert "running" in result.out
    assert "closed" in result.out


@pytest.mark.parametrize("has_basic", [True, False])
def test_basic_objects_that_a_device_leaves_out_at_other_levels_are_asked_for(has_basic) -> None:
    def answer(request: bytes) -> list[bytes]:
        if request[7] != 43 or (request[9] == 1 and not has_basic):
            return [mbap(request, bytes([request[7] | 0x80, 1]))]
        level = request[9]
        objects = {0: b"Maker", 1: b"M1", 2: b"1.0"} if level == 1 else {3: b"example.com"}
        listed = b"".join(bytes([at, len(text)]) + text for at, text in objects.items())
        return [mbap(request, bytes([43, 14, level, 0x02, 0, 0, len(objects)]) + listed)]

    with FakeServer(answer) as server:
        result = run("identify", f"127.0.0.1:{server.port}")
    assert (result.code, result.err) == (0, "")
    names = ["VendorName", "ProductCode", "MajorMinorRevision"] * has_basic + ["VendorUrl"]
    assert [line.split()[0] for line in result.out.splitlines()[: len(names)]] == names
