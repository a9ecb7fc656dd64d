"""Tables of cases, and the ends of lines in memory."""

import inspect
import os
import select
import threading
from collections.abc import Iterable, Iterator

import pytest

from libmodbus_py.tools.testing.wires import SerialWire, open_line, read_what_is_there, write_all
from tests.support.cases import each, each_case


def halves(table: Iterable[tuple[int, int]]) -> None:
    for check, (whole, half) in each(table):
        with check:
            assert whole // half == 2


def failure(table: Iterable[tuple[int, int]]) -> str:
    with pytest.raises(AssertionError) as caught:
        halves(table)
    return str(caught.value)


def test_every_failed_case_is_named_and_the_others_are_not() -> None:
    text = failure([(4, 2), (9, 3), (6, 3), (1, 0)])
    assert text.startswith("2 of 4 cases failed:\n  (9, 3)\n    test_cases.py:")
    assert "AssertionError: assert (9 // 3) == 2" in text
    assert "ZeroDivisionError: " in text
    assert "(4, 2)" not in text
    assert "(6, 3)" not in text


def test_an_empty_table_fails() -> None:
    assert failure([]) == "the table of cases is empty"


def test_each_case_calls_the_test_with_every_combination() -> None:
    calls = []

    @each_case("text", ["a", "b"])
    @each_case(("low", "high"), [(1, 2), pytest.param(3, 4, id="more")])
    def test(fixture: str, text: str, low: int, high: int) -> None:
        calls.append((fixture, text, low, high))

    test(fixture="f")  # type: ignore[call-arg]
    assert calls == [("f", "a", 1, 2), ("f", "a", 3, 4), ("f", "b", 1, 2), ("f", "b", 3, 4)]
    assert list(inspect.signature(test).parameters) == ["fixture"]


@pytest.fixture
def ends() -> Iterator[tuple[int, int]]:
    far, near, _ = open_line()
    yield far, near
    os.close(far)
    os.close(near)


@pytest.mark.timeout(20)
def test_reading_returns_the_available_bytes_at_once(ends: tuple[int, int]) -> None:
    far, near = ends
    assert read_what_is_there(far) == b""
    os.write(near, b"abc")
    assert select.select([far], [], [], 5)[0]
    assert read_what_is_there(far) == b"abc"
    assert read_what_is_there(far) == b""


@pytest.mark.timeout(20)
def test_more_bytes_than_a_pipe_holds_are_written_when_it_is_read(ends: tuple[int, int]) -> None:
    far, near = ends
    data = bytes(range(256)) * 1000
    thread = threading.Thread(target=write_all, args=(far, data))
    thread.start()
    read = b""
    while len(read) < len(data):
        read += os.read(near, 4096)
    thread.join()
    assert read == data


@pytest.mark.timeout(60)
def test_a_wire_whose_peer_does_not_read_can_be_closed(monkeypatch) -> None:
    """More is written than the terminals hold: what finds no room is lost, and not waited for."""
    monkeypatch.setattr("libmodbus_py.tools.testing.wires.TIMEOUT", 0.01)
    with SerialWire() as wire:
        client = os.open(wire.client, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for _ in range(50):
            select.select([], [client], [])
            os.write(client, bytes(4096))
        os.close(client)
