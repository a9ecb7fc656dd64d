"""
What is used a second time, or is over: a background server, a view of a table, frozen garbage.
"""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest

from libmodbus_py import Client, Device, Gateway, Mapping, Route, Server
from tests.support.cases import each_case

HERE = "tcp://127.0.0.1:0"

SERVERS: dict[str, Callable[[str], Any]] = {
    "server": lambda url: Server(Device(Mapping(holding_registers=10))).background(HERE),
    "gateway": lambda url: Gateway([Route(url)]).background(HERE),
}


@pytest.mark.parametrize("kind", SERVERS)
def test_a_background_that_runs_is_not_entered_again(kind: str) -> None:
    with SERVERS["server"]("") as behind:
        background = SERVERS[kind](behind.urls[0])
        with background as running:
            for _ in range(2):
                with pytest.raises(RuntimeError, match="call background"), background:
                    pass
            with Client(running.urls[0]) as client:
                assert client.read_holding_registers(0, 1) == [0]
        with pytest.raises(RuntimeError, match="call background"), background:
            pass


TABLES = ("coils", "discrete_inputs", "holding_registers", "input_registers")


@each_case("name", TABLES)
def test_a_view_in_a_with_statement_closes_a_copy(name: str) -> None:
    mapping = Mapping(10, 10, 10, 10)
    table = getattr(mapping, name)
    table[3] = 1
    with table.view as view:
        assert view[3] == 1
    table.view.release()
    table[4] = 1
    assert (table[3], table[4], table.view[4]) == (1, 1, 1)


PROGRAM = """
import gc, sys
from libmodbus_py import Device, Mapping, Server
counts = []
def stop(running):
    counts.append(gc.get_freeze_count())
    raise LookupError
{before}
start = gc.get_freeze_count()
for _ in range(2):
    try:
        Server(Device(Mapping(1))).serve_forever("tcp://127.0.0.1:0", on_listening=stop)
    except LookupError:
        counts.append(gc.get_freeze_count())
print(start, *counts)
"""


def counts(before: str) -> list[int]:
    """Return how much is frozen: before, and while and after each of two servers serves."""
    program = [sys.executable, "-c", PROGRAM.format(before=before)]
    done = subprocess.run(program, capture_output=True, text=True, check=True)
    return [int(each) for each in done.stdout.split()]


def test_serve_forever_unfreezes_what_it_froze() -> None:
    start, during, after, again, at_last = counts("")
    assert during > 10_000
    assert again > 10_000
    assert after <= start
    assert at_last <= start


def test_serve_forever_leaves_what_the_program_froze() -> None:
    start, *others = counts("gc.freeze()")
    assert start > 10_000
    # Some of it may be freed meanwhile.
    assert all(start - 500 <= count <= start for count in others)
