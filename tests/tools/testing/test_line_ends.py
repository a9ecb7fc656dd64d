"""The far ends of serial lines: nobody waits there for what was discarded meanwhile."""

import os
import select
import threading
from collections.abc import Iterator

import pytest

from libmodbus_py.tools.testing.wires import SerialWire, open_line, read_what_is_there, write_all


@pytest.fixture
def ends() -> Iterator[tuple[int, int]]:
    far, near, _ = open_line()
    yield far, near
    os.close(far)
    os.close(near)


@pytest.mark.timeout(20)
def test_what_is_gone_is_not_waited_for(ends: tuple[int, int]) -> None:
    far, near = ends
    assert read_what_is_there(far) == b""
    os.write(near, b"abc")
    assert select.select([far], [], [], 5)[0]
    assert read_what_is_there(far) == b"abc"
    assert read_what_is_there(far) == b""


@pytest.mark.timeout(20)
def test_more_than_there_is_room_for_is_written_when_somebody_reads(ends: tuple[int, int]) -> None:
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
def test_a_wire_that_nobody_reads_at_the_other_end_can_be_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """More is written than the terminals hold: what finds no room is lost, and not waited for."""
    monkeypatch.setattr("libmodbus_py.tools.testing.wires.TIMEOUT", 0.01)
    with SerialWire() as wire:
        client = os.open(wire.client, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        for _ in range(50):
            select.select([], [client], [])
            os.write(client, bytes(4096))
        os.close(client)
