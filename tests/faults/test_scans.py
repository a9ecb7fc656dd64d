"""
Scans and searches, while the n-th call of the system fails: the next one finds what there is.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import pytest

from libmodbus_py.protocol import framing
from libmodbus_py.protocol.tables import TABLES
from libmodbus_py.scan import scan, search
from tests.faults.injecting import Scenario, Trial, eventually, tried
from tests.faults.test_clients import Place, on_line, tcp, udp
from tests.support.peers import FakeUnit

PART = ("tools.scan", "client", "ports")

# Where a fault takes an answer away, the scan waits so long.
TIMEOUT = 0.05


def unit(request: bytes) -> list[bytes]:
    """Answer reads of holding registers, and all else with exception 1."""
    if request[1] == 3:
        return on_line(request)
    body = bytes([request[0], request[1] | 0x80, 1])
    return [body + framing.crc16(body).to_bytes(2, "little")]


@contextlib.contextmanager
def rtu(folder: Path) -> Iterator[str]:
    with FakeUnit(unit) as made:
        yield f"rtu://{made.path}?baudrate=115200&parity=N"


PLACES: dict[str, Place] = {"tcp": tcp, "udp": udp, "rtu": rtu}


def finds(url: str) -> bool:
    return [each.unit for each in scan(url, units=[1], timeout=1)] == [1]


def scanned(url: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        with trial.faults(), scan(url, units=[1], timeout=TIMEOUT) as found:
            for each in found:
                assert each.unit == 1
        assert eventually(lambda: finds(url))

    return scenario


def searched(url: str) -> Scenario:
    def scenario(trial: Trial) -> None:
        with trial.faults(), search(url, timeout=TIMEOUT, most_requests=8) as extents:
            assert {each.table for each in extents} <= set(TABLES)
        assert eventually(lambda: finds(url))

    return scenario


@pytest.mark.parametrize("kind", PLACES)
def test_a_scan(tmp_path: Path, kind: str) -> None:
    with PLACES[kind](tmp_path) as url:
        tried(scanned(url), *PART)


def test_a_search(tmp_path: Path) -> None:
    with udp(tmp_path) as url:
        tried(searched(f"{url}?unit=1"), *PART, errors=1)
