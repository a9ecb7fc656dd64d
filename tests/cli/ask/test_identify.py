"""
The commands identify and diagnose.
"""

from __future__ import annotations

import json

import pytest

from libmodbus_py import Device, Mapping, Server, pdu
from tests.support.commands import run
from tests.support.peers import FakeServer, mbap


def test_identify(url: str) -> None:
    done = run("identify", url)
    assert done.code == 0
    assert "VendorName          libmodbus-py\n" in done.out
    assert "running             True\n" in done.out
    found = json.loads(run("identify", url, "--level", "0", "--json").out)
    assert found["VendorName"] == "libmodbus-py"
    assert "ProductCode" not in found
    assert run("identify", url, "--level", "all").code == 2


def test_a_server_id_without_a_run_indicator_is_shown_as_it_was_sent() -> None:
    device = Device(Mapping(), server_id=pdu.ServerId(b"A", None, b"CME"))
    with Server(device).background("tcp://127.0.0.1:0") as running:
        told = run("identify", running.urls[0])
        found = json.loads(run("identify", running.urls[0], "--json").out)
    assert "server id           ACME\n" in told.out
    assert "running" not in told.out
    assert found["server id"] == "ACME"
    assert "running" not in found


@pytest.mark.parametrize("has_basic", [True, False])
def test_basic_objects_that_a_device_leaves_out_at_other_levels_are_asked_for(
    has_basic: bool,
) -> None:
    def answer(request: bytes) -> list[bytes]:
        if request[7] != 43 or (request[9] == 1 and not has_basic):
            return [mbap(request, bytes([request[7] | 0x80, 1]))]
        level = request[9]
        objects = {0: b"Maker", 1: b"M1", 2: b"1.0"} if level == 1 else {3: b"example.com"}
        listed = b"".join(bytes([at, len(text)]) + text for at, text in objects.items())
        return [mbap(request, bytes([43, 14, level, 0x02, 0, 0, len(objects)]) + listed)]

    with FakeServer(answer) as server:
        done = run("identify", f"127.0.0.1:{server.port}")
    assert (done.code, done.err) == (0, "")
    names = ["VendorName", "ProductCode", "MajorMinorRevision"] * has_basic + ["VendorUrl"]
    assert [line.split()[0] for line in done.out.splitlines()[: len(names)]] == names


def test_diagnose(url: str) -> None:
    done = run("diagnose", url)
    assert "exception status               00000000\n" in done.out
    assert "bus message count " in done.out
    assert run("diagnose", url, "return-query-data", "0x1234").out == "4660\n"
    assert run("diagnose", url, "0", "7", "--json").out == '{"unit": 1, "return query data": 7}\n'
    assert run("diagnose", url, "99").code == 1
    assert "one of return-query-data" in run("diagnose", url, "nonsense").err
