"""
write --verify: every kind of write is read back, and what differs is named.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from libmodbus_py import Access, Device, IllegalDataAddress, Mapping, Server
from tests.support.cases import each_case
from tests.support.commands import run
from tests.support.peers import FakeServer, mbap


@pytest.fixture
def mapping() -> Mapping:
    return Mapping(coils=100, holding_registers=200)


@pytest.fixture
def url(mapping: Mapping) -> Iterator[str]:
    device = Device(mapping, files={4: [0] * 20})
    with Server(device).background("tcp://127.0.0.1:0") as running:
        yield running.urls[0]


@each_case(
    "words",
    [
        "hr 0 5",
        "hr 0 5 6 7 co 3 on coils 7 1 0 1",
        "hr 0 5 --multiple co 1 on",
        "hr 0 -1",
        "hr 10 3.5 --type float32 --order CDAB",
        "hr 3 --mask 0xFF00 0x0012",
        "hr 3 1 2 --and-read 0 4",
        "file:4 3 8 9",
        "40123 7",
        "hr 7 1 --count-from-1",
    ],
)
def test_what_was_stored_is_right(url: str, words: str) -> None:
    done = run("write", url, *words.split(), "--verify")
    assert (done.code, done.err) == (0, "")


class Stubborn:
    """A device that acknowledges writes, and keeps its registers and coils: all are 7 or on."""

    def __call__(self, request: bytes) -> list[bytes]:
        function, count = request[7], int.from_bytes(request[10:12], "big")
        if function == 3:
            data = bytes([0, 7]) * count
        elif function == 1:
            data = bytes([(1 << count) - 1])
        else:
            return [mbap(request, request[7:12] if function in (15, 16) else request[7:])]
        return [mbap(request, bytes([function, len(data)]) + data)]


@each_case(
    ("words", "lines"),
    [
        ("hr 5 7", []),
        ("hr 5 8", ["hr 5: wrote 8, reads 7"]),
        ("hr 5 7 8 9", ["hr 6: wrote 8, reads 7", "hr 7: wrote 9, reads 7"]),
        ("co 3 off", ["co 3: wrote 0, reads 1"]),
        ("co 3 on off", ["co 4: wrote 0, reads 1"]),
        ("hr 5 8 co 3 off", ["hr 5: wrote 8, reads 7", "co 3: wrote 0, reads 1"]),
        ("hr 5 --mask 0xFFF0 0x0007", []),
        ("hr 5 --mask 0xFFF0 0x0006", ["hr 5: wrote 6, reads 7"]),
        ("hr 6 8 --count-from-1", ["hr 6: wrote 8, reads 7"]),
    ],
)
def test_what_differs_is_named(words: str, lines: list[str]) -> None:
    with FakeServer(Stubborn()) as server:
        done = run("write", f"127.0.0.1:{server.port}", *words.split(), "--verify")
    assert done.code == (1 if lines else 0)
    assert done.err.splitlines() == [f"libmodbus-py: {line}" for line in lines]


def test_a_cell_that_cannot_be_read_fails() -> None:
    device = Device(Mapping(holding_registers=9), before_read=refusing)
    with Server(device).background("tcp://127.0.0.1:0") as running:
        done = run("write", running.urls[0], "hr", 0, 1, "--verify")
    assert done.code == 1
    assert "ReadHoldingRegisters(address=0, count=1): illegal" in done.err


def refusing(access: Access) -> None:
    raise IllegalDataAddress


def test_a_broadcast_cannot_be_verified() -> None:
    done = run("write", "/dev/no-such", "-u", 0, "hr", 0, 1, "--verify")
    assert done.code == 2
    assert "--verify cannot be used with unit 0: nothing answers a broadcast" in done.err
